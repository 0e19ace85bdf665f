"""Nonlinear elements: their laws and the motions of rigs that have them (THEORY §9)."""
