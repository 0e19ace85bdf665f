"""Files in and out: TOML with lines, JSON with nulls, writing without half-written files."""
