"""Fits of shapes to images: cases, coverage, real data."""
