"""Training on the stream, validation and accuracy."""
