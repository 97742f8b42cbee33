"""Training of an auto-decoder."""
