"""Commands of `sdm train`, one for each kind of network."""
