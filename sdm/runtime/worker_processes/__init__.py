"""Small processes beside this one, each with a Python lock of its own: they import little, and share memory with it."""
