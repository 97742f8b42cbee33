"""Facts about this machine and its installation, and kernels compiled ahead: for `sdm doctor`."""
