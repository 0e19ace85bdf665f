"""Results as plain content for JSON: numbers, texts, lists and tables."""
