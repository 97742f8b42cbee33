"""Sizes of an acceleration structure, and its build beside a map."""
