"""Image formation estimated with the shape: blur, uneven intensities, correlated noise, and a check of the model."""
