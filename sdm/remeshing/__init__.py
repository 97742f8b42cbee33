"""Closed surfaces of any meshes."""

from sdm.remeshing.deviation import Deviation, WatertightReport
from sdm.remeshing.watertight import watertight

__all__ = ["Deviation", "WatertightReport", "watertight"]
