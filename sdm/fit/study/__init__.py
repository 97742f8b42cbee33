"""Simulated images."""
