"""Layouts of sample folders: what trainings of others read."""
