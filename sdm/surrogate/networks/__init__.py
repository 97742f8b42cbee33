"""SDMNN, SDMNN+ and a decomposition, from parameters to maps on one grid."""
