"""Profiles and compute-sanitizer."""
