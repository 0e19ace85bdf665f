"""Estimators: from a model and a spectrum to parameters with their uncertainty."""
