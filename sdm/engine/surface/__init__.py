"""Surfaces of maps, made where the map is."""

from sdm.engine.surface.marching_cubes import isosurface

__all__ = ["isosurface"]
