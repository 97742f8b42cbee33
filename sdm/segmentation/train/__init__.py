"""Methods, objective and training loop."""
