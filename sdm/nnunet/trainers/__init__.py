"""Trainers of nnU-Net v2, which looks for them here by their names."""
