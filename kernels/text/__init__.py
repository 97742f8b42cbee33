"""Numbers in text, as mesh files have them."""
