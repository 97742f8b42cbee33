"""Commands about this installation: what it has, and what a shell needs of it."""
