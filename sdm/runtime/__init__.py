"""Torch and Warp together: memory, streams, CUDA graphs, prefetch."""
