"""Files of meshes and of signed distance maps, read and written.

World coordinates of a file are the mesh's coordinates, number for number. A NIfTI file's world is right-anterior-
superior (RAS+) by its standard; an NRRD file is written with the same numbers in "right-anterior-superior" space. A
mesh in another space (LPS, as some medical software exports) has to be turned before it meets such an image.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sdm.runtime.lazy_names import lazy_names

if TYPE_CHECKING:
    from sdm.io.maps.formats import FORMATS, check_target
    from sdm.io.maps.save_and_load import grid_like, load, load_band, save, write_streamed
    from sdm.io.meshes.load import load_mesh, mesh_files
    from sdm.io.meshes.mesh_tree import mesh_tree
    from sdm.io.meshes.write import save_mesh

# Where each name comes from. A name is imported when it is first used: processes that only write wait for no torch.
_HOMES = {
    "FORMATS": "maps.formats",
    "check_target": "maps.formats",
    "grid_like": "maps.save_and_load",
    "load": "maps.save_and_load",
    "load_band": "maps.save_and_load",
    "load_mesh": "meshes.load",
    "mesh_files": "meshes.load",
    "mesh_tree": "meshes.mesh_tree",
    "save": "maps.save_and_load",
    "save_mesh": "meshes.write",
    "write_streamed": "maps.save_and_load",
}

__all__ = [
    "FORMATS",
    "check_target",
    "grid_like",
    "load",
    "load_band",
    "load_mesh",
    "mesh_files",
    "mesh_tree",
    "save",
    "save_mesh",
    "write_streamed",
]

__getattr__ = lazy_names(__name__, _HOMES)
