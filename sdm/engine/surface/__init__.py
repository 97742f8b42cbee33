"""Surfaces of maps, made where the map is."""

from sdm.engine.surface.marching_cubes import band_isosurface, isosurface

__all__ = ["band_isosurface", "isosurface"]
