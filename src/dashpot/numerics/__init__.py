"""Numerical tools that know nothing of rigs: minimisation, stacks of small systems, exact ranks."""
