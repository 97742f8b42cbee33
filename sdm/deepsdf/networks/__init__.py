"""Decoders, the auto-decoder with its codes, and the prior of codes."""
