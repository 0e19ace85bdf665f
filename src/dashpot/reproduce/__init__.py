"""Published work computed again."""
