"""Exact signed distance maps of triangle meshes, on GPUs and CPUs. Sign: negative inside."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sdm.runtime.rare_collections import rare_collections as _rare_collections

if TYPE_CHECKING:
    from sdm import compat as compat
    from sdm import dataset as dataset
    from sdm import deepsdf as deepsdf
    from sdm import explore as explore
    from sdm import fit as fit
    from sdm import inspect as inspect
    from sdm import io as io
    from sdm import losses as losses
    from sdm import metrics as metrics
    from sdm import sampling as sampling
    from sdm import segmentation as segmentation
    from sdm import shapes as shapes
    from sdm import stream as stream
    from sdm import surrogate as surrogate
    from sdm import viz as viz
    from sdm.core.grid import Grid
    from sdm.core.mesh import TriangleMesh
    from sdm.core.signed_distance_map import SDM
    from sdm.core.sparse_sdm import SparseSDM
    from sdm.dataset import SDMDataset
    from sdm.engine.api import signed_distance, signed_distance_map
    from sdm.engine.band.calls import narrow_band
    from sdm.engine.closest_points import Closest
    from sdm.engine.distance_transform import euclidean_distance_transform
    from sdm.engine.many import signed_distance_maps, signed_distances
    from sdm.engine.mesh_index import MeshIndex
    from sdm.engine.orient import orient_faces
    from sdm.errors import DeviceError, FormatError, GridError, MeshError, SDMError, SDMWarning
    from sdm.inspect import MeshReport, inspect_mesh
    from sdm.io import load, load_mesh, save, save_mesh
    from sdm.remeshing import WatertightReport, watertight
    from sdm.runtime import graphs as cuda_graphs  # noqa: F401
    from sdm.stream import SDMStream

__version__ = "0.1.0"

# Packages that are part of the library's face, imported when they are first used.
_PACKAGES = {
    "compat": "compat",
    "cuda_graphs": "runtime.graphs",
    "dataset": "dataset",
    "deepsdf": "deepsdf",
    "explore": "explore",
    "fit": "fit",
    "inspect": "inspect",
    "io": "io",
    "losses": "losses",
    "metrics": "metrics",
    "sampling": "sampling",
    "segmentation": "segmentation",
    "shapes": "shapes",
    "stream": "stream",
    "surrogate": "surrogate",
    "viz": "viz",
}

# Where each name comes from. A name is imported when it is first used, so that `sdm --help` waits for no torch.
_HOMES = {
    "SDM": "core.signed_distance_map",
    "Closest": "engine.closest_points",
    "DeviceError": "errors",
    "FormatError": "errors",
    "Grid": "core.grid",
    "GridError": "errors",
    "MeshError": "errors",
    "MeshIndex": "engine.mesh_index",
    "MeshReport": "inspect",
    "SDMDataset": "dataset",
    "SDMError": "errors",
    "SDMWarning": "errors",
    "SDMStream": "stream",
    "SparseSDM": "core.sparse_sdm",
    "TriangleMesh": "core.mesh",
    "euclidean_distance_transform": "engine.distance_transform",
    "inspect_mesh": "inspect",
    "load": "io",
    "load_mesh": "io",
    "narrow_band": "engine.band.calls",
    "orient_faces": "engine.orient",
    "save": "io",
    "save_mesh": "io",
    "WatertightReport": "remeshing",
    "signed_distance": "engine.api",
    "signed_distance_map": "engine.api",
    "signed_distance_maps": "engine.many",
    "signed_distances": "engine.many",
    "watertight": "remeshing",
}

__all__ = [
    "SDM",
    "Closest",
    "DeviceError",
    "FormatError",
    "Grid",
    "GridError",
    "MeshError",
    "MeshIndex",
    "MeshReport",
    "SDMDataset",
    "SDMError",
    "SDMStream",
    "SDMWarning",
    "SparseSDM",
    "TriangleMesh",
    "WatertightReport",
    "euclidean_distance_transform",
    "inspect_mesh",
    "load",
    "load_mesh",
    "narrow_band",
    "orient_faces",
    "save",
    "save_mesh",
    "signed_distance",
    "signed_distance_map",
    "signed_distance_maps",
    "signed_distances",
    "watertight",
]


def __getattr__(name: str) -> Any:
    if name not in _PACKAGES and name not in _HOMES:
        raise AttributeError(f"module 'sdm' has no attribute {name!r}")
    with _rare_collections():
        if name in _PACKAGES:
            return import_module(f"sdm.{_PACKAGES[name]}")
        value = getattr(import_module(f"sdm.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES, *_PACKAGES})
