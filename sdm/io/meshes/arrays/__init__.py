"""Meshes as arrays, without torch and Warp: see `sdm.runtime.worker_processes`."""
