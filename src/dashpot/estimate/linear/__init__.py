"""Estimators on the equation of motion: the Gram (G) and what solves it."""
