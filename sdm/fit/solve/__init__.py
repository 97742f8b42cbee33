"""Finding the shape: initial guess, Gauss-Newton, posterior, diagnosis."""
