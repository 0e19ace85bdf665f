"""Functional mock-up units (FMI 3.0): the description, the source in C, the archive."""
