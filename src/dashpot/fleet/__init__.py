"""Fleets: one rig, very many data sets."""
