"""Commands about families of shapes and shape models."""
