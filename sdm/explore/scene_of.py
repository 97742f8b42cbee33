"""Scenes by name or file: a family, a mesh, a map, a narrow band, a dataset."""

from __future__ import annotations

from pathlib import Path

import torch

from sdm.core.signed_distance_map import SDM
from sdm.core.sparse_sdm import SparseSDM
from sdm.explore.controls import Scene
from sdm.explore.family_scene import FamilyScene
from sdm.explore.map_scene import MapScene
from sdm.explore.mesh_scene import MeshScene

COCHLEA = "cochlea"


def scene_of(thing: str, *, resolution: int, device: torch.device) -> tuple[Scene, str]:
    """The scene of a name or a file, and the unit of its lengths, "" where nothing says it.

    Args:
        thing: A family's name, FILE.py:NAME (which is run), a shape model's MODEL.npz, or the path of a mesh, a map, a
            narrow band or a dataset of `sdm generate`.
        resolution: Voxels along each axis of maps that are computed.
        device: Where they are.

    Raises:
        SDMError: None of these, or a file that cannot be read, in one sentence.
    """
    from sdm.io import load, load_mesh
    from sdm.io.maps.formats import is_map_name
    from sdm.shapes import families, load_family

    path = Path(thing)
    if (path.is_dir() and _is_dataset(path)) or path.name.endswith(".part"):
        from sdm.dataset import SDMDataset

        dataset = SDMDataset(path)
        return MapScene(path.name, dataset.sdm, len(dataset)), _length_unit(dataset.parameters)
    if thing in families or _is_family_file(path):
        family = load_family(thing)
        return FamilyScene(family, resolution, device, _surrogate_of(thing)), _length_unit(family.parameters)
    if is_map_name(path):
        found: SDM | SparseSDM = load(path)
        field = found.to_dense() if isinstance(found, SparseSDM) else found
        return MapScene(path.name, lambda number: field), ""
    return MeshScene(load_mesh(path), resolution, device), ""


def _is_dataset(path: Path) -> bool:
    import json

    from sdm.dataset.manifest import KEY

    try:
        manifest = json.loads((path / "zarr.json").read_text())["attributes"][KEY]
    except (OSError, ValueError, KeyError, TypeError):
        return False
    return isinstance(manifest, dict) and "recipe" in manifest


def _is_family_file(path: Path) -> bool:
    """True of FILE.py:NAME, and of an .npz that holds a shape model and no map."""
    if ".py:" in path.name.lower():
        return True
    if path.suffix.lower() != ".npz" or not path.is_file():
        return False
    import zipfile

    import numpy as np

    try:
        with np.load(path, allow_pickle=False) as content:
            return "header" in content.files and '"kind"' in str(content["header"])
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return False


def _surrogate_of(name: str) -> object | None:
    if name != COCHLEA:
        return None
    from sdm.surrogate import Predictor, shipped_weights

    return Predictor() if shipped_weights() is not None else None


def _length_unit(parameters: tuple[object, ...]) -> str:
    units = {getattr(p, "unit", "1") for p in parameters} & {"mm", "cm", "m", "um"}
    return units.pop() if len(units) == 1 else ""
