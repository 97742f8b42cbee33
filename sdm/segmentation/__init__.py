"""Segmentation networks guided by distance maps: methods, data, training, prediction, scores."""
