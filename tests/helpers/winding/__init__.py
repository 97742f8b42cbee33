"""Caps of the winding number, for the tests of its kernels."""
