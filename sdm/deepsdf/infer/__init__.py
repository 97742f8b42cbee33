"""Codes of new shapes, surfaces and renderings from a trained network."""
