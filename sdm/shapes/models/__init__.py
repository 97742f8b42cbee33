"""Statistical shape models: from meshes to a mean, modes and standard deviations."""
