"""Text tables: one module a format."""
