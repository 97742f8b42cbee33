"""Prediction by sliding windows, ensembles, scores."""
