"""Updates a second of `sdm explore`."""
