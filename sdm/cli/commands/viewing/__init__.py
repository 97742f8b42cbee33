"""Commands that show maps: in a window, and in a browser."""
