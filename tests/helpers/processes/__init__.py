"""Processes beside that of the tests."""
