"""Rigs and estimates for other programs: matrices, state spaces, transfer functions, models of simulators, tables."""
