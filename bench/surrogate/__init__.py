"""Surrogates: accuracy, timing, plots."""
