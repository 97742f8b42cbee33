"""Surrogates of any family of shapes: trained, kept, measured and asked by the family's own parameters and grid."""
