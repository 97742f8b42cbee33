"""The formats of mesh files, by the end of the file's name."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

from sdm.errors import MeshError
from sdm.io.maps.formats import is_map_name
from sdm.io.meshes.neuro.brain_surfaces import read_freesurfer, read_gifti
from sdm.io.meshes.obj import read_obj
from sdm.io.meshes.off import read_off
from sdm.io.meshes.ply import read_ply
from sdm.io.meshes.polygons import PolygonMesh
from sdm.io.meshes.stl import read_stl
from sdm.io.meshes.vtk.legacy_polydata import read_vtk
from sdm.io.meshes.vtk.xml_polydata import read_vtp

# The endings of FreeSurfer's surfaces.
FREESURFER = ("pial", "white", "inflated", "smoothwm")
# Readers of our own: from the bytes of a file and its path, for messages, to its polygons.
READERS: dict[str, Callable[[bytes, Path], PolygonMesh]] = {
    "stl": read_stl,
    "stl_ascii": read_stl,
    "ply": read_ply,
    "obj": read_obj,
    "off": read_off,
    "gii": read_gifti,
    "vtk": read_vtk,
    "vtp": read_vtp,
    **dict.fromkeys(FREESURFER, read_freesurfer),
}
# Formats that trimesh reads, with the module that each needs; all of those are in the extra `formats`.
TRIMESH = {"glb": "", "gltf": "", "dae": "collada", "zae": "collada", "3mf": "lxml", "3dxml": "lxml", "xaml": "lxml"}
# Archives of meshes, unpacked first.
ARCHIVES = ("zip", "tar.gz", "tar.bz2", "bz2", "gz")
# Those of a single file, whose own ending comes before: model.ply.gz.
PACKERS = ("gz", "bz2")
# Drawings and points: they have no triangles, but trimesh says so more kindly than we could.
DRAWINGS = ("dxf", "xyz")
# The endings that messages name first.
USUAL = ("stl", "ply", "obj", "off", "glb", "gltf")


def known_endings() -> list[str]:
    """The endings of every format, the usual ones first."""
    return [*USUAL, *sorted({*READERS, *TRIMESH, *ARCHIVES} - {*USUAL})]


def mesh_endings(packed: bool = True) -> tuple[str, ...]:
    """The endings, with their dots, of the files that are taken for meshes in a folder.

    Args:
        packed: Also those of single files that are compressed, such as `.ply.gz`.
    """
    plain = tuple(f".{ending}" for ending in (*READERS, *TRIMESH) if _is_installed(ending))
    return (*plain, *(f"{ending}.{packer}" for ending in plain for packer in PACKERS)) if packed else plain


def ending_of(path: Path) -> str:
    """The ending of a mesh file's name, without its dot and in small letters.

    Raises:
        MeshError: It is not known, or its reader is not installed.
    """
    name = path.name.lower()
    # The longer one of .bz2 and .tar.bz2.
    fitting = [ending for ending in (*known_endings(), *DRAWINGS) if name.endswith(f".{ending}")]
    found = max(fitting, key=len, default=None) or _of_plugins(name)
    if found == "gz" and not name.endswith(mesh_endings()):
        found = None
    if found is None:
        if is_map_name(path):
            raise MeshError(
                f"{path} ends like an image or a map, not like a mesh: sdm edt takes label volumes, one at a time, and "
                "sdm surface makes meshes of them and of maps"
            )
        ending = f"the ending {path.suffix}" if path.suffix else "a name without an ending"
        raise MeshError(f"{path} is no mesh by {ending}; known are .{', .'.join(known_endings())}")
    if not _is_installed(found):
        raise MeshError(f"{path} needs {TRIMESH[found]} to be read: pip install '.[formats]' in a clone")
    return found


def _is_installed(ending: str) -> bool:
    module = TRIMESH.get(ending)
    return not module or find_spec(module) is not None


def _of_plugins(name: str) -> str | None:
    """The ending, if trimesh has a reader for it through a package that this project does not ask for."""
    import trimesh

    return next((ending for ending in trimesh.available_formats() if name.endswith(f".{ending}")), None)
