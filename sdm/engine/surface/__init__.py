"""Surfaces of maps, made where the map is."""

from sdm.engine.surface.level_surfaces import Method, band_isosurface, check_method, isosurface

__all__ = ["Method", "band_isosurface", "check_method", "isosurface"]
