"""Files of meshes and of signed distance maps, read and written.

World coordinates of a file are the mesh's coordinates, number for number. A NIfTI file's world is right-anterior-
superior (RAS+) by its standard; an NRRD file is written with the same numbers in "right-anterior-superior" space. A
mesh in another space (LPS, as some medical software exports) has to be turned before it meets such an image.
"""

from sdm.io.maps.formats import FORMATS, check_target
from sdm.io.maps.save_and_load import grid_like, load, load_band, save, write_streamed
from sdm.io.meshes.load import load_mesh, mesh_files
from sdm.io.meshes.mesh_tree import mesh_tree
from sdm.io.meshes.write import save_mesh

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
