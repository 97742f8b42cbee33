"""Scenes by name or file: a family, a mesh, a map, a narrow band, a dataset, a model of codes."""

from __future__ import annotations

from pathlib import Path

import torch

from sdm.core.signed_distance_map import SDM
from sdm.core.sparse_sdm import SparseSDM
from sdm.errors import SDMError
from sdm.explore.controls import Scene
from sdm.explore.family_scene import FamilyScene
from sdm.explore.map_scene import MapScene
from sdm.explore.mesh_scene import MeshScene
from sdm.shapes import Family

COCHLEA = "cochlea"
# The DeepSDF model that comes with the package, and what others are called.
CODES, MODEL = "deepsdf", ".pt"


def scene_of(thing: str, *, resolution: int, device: torch.device, surrogate: Path | None = None) -> tuple[Scene, str]:
    """The scene of a name or a file, and the unit of its lengths, "" where nothing says it.

    Args:
        thing: A family's name, FILE.py:NAME (which is run), a shape model's MODEL.npz, or the path of a mesh, a map, a
            narrow band, a dataset of `sdm generate` or a DeepSDF model, MODEL.pt; "deepsdf" is the one that comes with
            the package.
        resolution: Voxels along each axis of maps that are computed.
        device: Where they are.
        surrogate: Of a family: a folder of `sdm train sdmnn --family`, or of the cochlea a file of weights. By default
            the cochlea's that comes with the package.

    Raises:
        SDMError: None of these, or a file that cannot be read, in one sentence.
    """
    from sdm.io import load, load_mesh
    from sdm.io.maps.formats import is_map_name
    from sdm.shapes import families, load_family

    path = Path(thing)
    if surrogate is not None and thing not in families and not _is_family_file(path):
        raise SDMError(f"--surrogate is of a family, and {thing} is none")
    if thing == CODES or path.suffix.lower() == MODEL:
        from sdm.deepsdf import DeepSDF
        from sdm.explore.codes_scene import CodesScene

        model = DeepSDF.load(COCHLEA if thing == CODES else path, device)
        return CodesScene(f"DeepSDF, {COCHLEA if thing == CODES else path.name}", model, resolution), (
            "mm" if thing == CODES else ""
        )
    if (path.is_dir() and _is_dataset(path)) or path.name.endswith(".part"):
        from sdm.dataset import SDMDataset

        dataset = SDMDataset(path)
        return MapScene(path.name, dataset.sdm, len(dataset)), _length_unit(dataset.parameters)
    if thing in families or _is_family_file(path):
        family = load_family(thing)
        return FamilyScene(family, resolution, device, _surrogate_of(thing, family, surrogate)), _length_unit(
            family.parameters
        )
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


def _surrogate_of(name: str, family: Family, path: Path | None) -> object | None:
    from sdm.surrogate import Predictor, shipped_weights

    if path is not None and path.is_dir():
        from sdm.shapes.named_family import differs_from
        from sdm.surrogate.families.family_file import FamilyPredictor

        predictor = FamilyPredictor(path)
        different = differs_from(family, predictor.record["family"])
        if different is not None:
            raise SDMError(f"{path} is the surrogate of another family than {name}: its {different} differs")
        return predictor
    if path is not None and name != COCHLEA:
        raise SDMError(f"{path} is no folder: the surrogate of {name} is one, which sdm train sdmnn --family writes")
    if name != COCHLEA or (path is None and shipped_weights() is None):
        return None
    return Predictor(path)


def moving_scene_of(
    thing: str, image: Path | None, *, resolution: int, device: torch.device, seed: int
) -> tuple[Scene, str]:
    """The scene of a family's stream, or, with an image, of its fit to that.

    Raises:
        SDMError: No family, or an image that cannot be read.
    """
    from sdm.io import load
    from sdm.shapes import load_family

    family = load_family(thing)
    unit = _length_unit(family.parameters)
    if image is not None:
        from sdm.explore.fit_scene import FitScene

        scan = load(image)
        if not isinstance(scan, SDM):
            raise SDMError(f"{image} is a narrow band, and a fit is to an image")
        return FitScene(image.name, scan, family, device), unit
    from sdm.explore.stream_scene import StreamScene

    return StreamScene(family, resolution, device, seed), unit


def _length_unit(parameters: tuple[object, ...]) -> str:
    units = {getattr(p, "unit", "1") for p in parameters} & {"mm", "cm", "m", "um"}
    return units.pop() if len(units) == 1 else ""
