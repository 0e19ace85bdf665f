"""Masses, dampers and springs of a vibrating rig from noisy test data."""
