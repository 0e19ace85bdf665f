"""Physical parameters from measured modes."""
