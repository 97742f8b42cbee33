"""Surfaces of brain imaging."""
