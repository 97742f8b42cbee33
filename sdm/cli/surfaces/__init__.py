"""The work of commands that make surfaces."""
