"""Newton's sparse signed distance fields (`Mesh.build_sdf`), which are textures on a GPU.

It chooses its own grid from a voxel's size, so values are read at its own voxels next to the places that are asked for,
and compared there. Distances are Warp's, signs by winding numbers, values float32; defaults else. In the subgrids that
it keeps all voxels are there, so its band is about as wide as what is asked for or wider.
"""

# Annotations are not put off: Warp would not find a kernel's that is made in a function.
import importlib
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp

import sdm
from sdm.bench.common.meshes import Case

NAME = "Newton"


@dataclass(frozen=True)
class SparseField:
    """A field that Newton made.

    Args:
        seconds: Of each call, from vertices and faces to the textures.
        voxels: Those that are stored in subgrids.
        nbytes: Of these, without the coarse texture and the table.
        points: (N,3) of its own voxels.
        values: (N,) there.
    """

    seconds: list[float]
    voxels: int
    nbytes: int
    points: np.ndarray
    values: np.ndarray


def missing(device: str) -> str | None:
    """Why it cannot run here, as a sentence; None if it can."""
    if not device.startswith("cuda"):
        return f"{NAME} is left out: it makes its fields on a GPU alone"
    try:
        importlib.import_module("newton")
    except ImportError as error:
        return f"{NAME} is left out, as it cannot be imported: {error}"
    return None


def sparse_field(
    case: Case, grid: sdm.Grid, half_width: float, points: np.ndarray, runs: int, device: str
) -> SparseField:
    """The field of a mesh with the voxels' size of a grid, made `runs` times, read next to points (N,3)."""
    newton = importlib.import_module("newton")
    step = max(grid.spacing)
    width = half_width * step

    def make() -> Any:
        mesh = newton.Mesh(case.vertices, case.faces.reshape(-1), compute_inertia=False)
        return mesh.build_sdf(
            device=device,
            narrow_band_range=(-width, width),
            target_voxel_size=step,
            margin=width,
            texture_format="float32",
            sign_method="winding",
            # No edges for contacts.
            edge_lower_angle_threshold_rad=-1.0,
        )

    # Compiles, and pays for what later ones have.
    made = make()
    seconds = []
    for _ in range(runs):
        # By the clock, as it works on Warp's stream, and waits for the device itself.
        start = time.perf_counter()
        made = make()
        wp.synchronize_device(device)
        seconds.append(time.perf_counter() - start)
    found = made.to_texture_kernel_data()
    low, size = np.array(found.sdf_box_lower), np.array(found.voxel_size)
    last = np.round((np.array(found.sdf_box_upper) - low) / size)
    index = np.clip(np.round((points - low) / size), 0, last).astype(np.int32)
    samples = found.num_subgrids * (found.subgrid_size + 1) ** 3
    return SparseField(
        seconds,
        found.num_subgrids * found.subgrid_size**3,
        4 * samples * (2 if found.paired_samples else 1),
        low + size * index,
        _values_at(found, index, device),
    )


def _values_at(field: Any, index: np.ndarray, device: str) -> np.ndarray:
    # It has no public way to read a voxel.
    textures = importlib.import_module("newton._src.geometry.sdf_texture")
    read = textures.texture_sample_sdf_at_voxel

    @wp.kernel(module="unique")
    def read_voxels(
        field: textures.TextureSDFData, index: wp.array(dtype=wp.vec3i), values: wp.array(dtype=wp.float32)
    ):
        at = index[wp.tid()]
        values[wp.tid()] = read(field, at[0], at[1], at[2])

    values = torch.empty(len(index), dtype=torch.float32, device=device)
    places = wp.array(index, dtype=wp.vec3i, device=device)
    wp.launch(read_voxels, dim=len(index), inputs=[field, places, wp.from_torch(values)], device=device)
    wp.synchronize_device(device)
    return values.cpu().numpy()
