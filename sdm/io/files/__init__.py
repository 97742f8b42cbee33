"""Atomic writes, locks and listings: what every file format shares."""
