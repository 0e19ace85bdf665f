"""Estimators for rigs with nonlinear elements (THEORY §9)."""
