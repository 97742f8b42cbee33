"""Exact signed distance maps of triangle meshes, on GPUs and CPUs. Sign: negative inside."""

from sdm.engine import MeshIndex, signed_distance, signed_distance_map, signed_distance_maps
from sdm.errors import DeviceError, FormatError, GridError, MeshError, SDMError
from sdm.field import SDM
from sdm.grid import Grid
from sdm.inspect import MeshReport, inspect_mesh
from sdm.io import load, load_mesh, save
from sdm.mesh import TriangleMesh

__version__ = "0.1.0"

__all__ = [
    "SDM",
    "DeviceError",
    "FormatError",
    "Grid",
    "GridError",
    "MeshError",
    "MeshIndex",
    "MeshReport",
    "SDMError",
    "TriangleMesh",
    "inspect_mesh",
    "load",
    "load_mesh",
    "save",
    "signed_distance",
    "signed_distance_map",
    "signed_distance_maps",
]
