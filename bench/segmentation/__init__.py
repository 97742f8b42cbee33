"""The studies of Juhl et al. and Ma et al."""
