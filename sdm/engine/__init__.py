"""The public calls, the acceleration structure as tensors, and the torch operators."""
