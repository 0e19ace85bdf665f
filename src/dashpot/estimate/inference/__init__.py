"""What an answer is worth: uncertainty, intervals, diagnostics."""
