"""Yamane (1989): its tables, figures and rig."""
