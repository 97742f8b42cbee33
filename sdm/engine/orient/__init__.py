"""Orientation of faces patch by patch, by what sees them from outside."""

from sdm.engine.orient.faces import orient_faces

__all__ = ["orient_faces"]
