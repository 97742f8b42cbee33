"""Prediction by shipped weights, with torch, ONNX Runtime or OpenVINO."""
