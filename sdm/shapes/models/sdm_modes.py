"""Principal components of signed distance maps: shapes without correspondence.

M. Leventon et al., "Statistical shape influence in geodesic active contours", CVPR 2000; A. Tsai et al., "A shape-based
approach to the segmentation of medical imagery using level sets", IEEE TMI 2003.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from sdm.core.device import choose_device
from sdm.core.given_values import as_path
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.engine.api import signed_distance_map
from sdm.errors import FormatError, MeshError
from sdm.shapes.family import check_resolution
from sdm.shapes.models.even_template import even_template
from sdm.shapes.models.lay_template import TemplateLayer
from sdm.shapes.models.measures import compactness
from sdm.shapes.models.model_file import read_arrays, write_arrays
from sdm.shapes.models.procrustes import rotations

KIND = "sdm model of maps"
ARRAYS = ("mean", "modes", "deviations", "origin", "spacing")
SHARE, RESOLUTION, TRIANGLES = 0.98, 64, 3000


class SDMModes:
    """Maps mean + sum_k theta_k s_k mode_k on one grid; its zero level is a shape of any topology, and no exact map.

    Args:
        mean: (nx,ny,nz) mean map, negative inside.
        modes: (M,nx,ny,nz), orthonormal.
        deviations: (M,) standard deviations of the maps along the modes.
        grid: Where.
        facts: What it was made from.
    """

    def __init__(
        self, mean: Tensor, modes: Tensor, deviations: Tensor, grid: Grid, facts: dict[str, Any] | None = None
    ) -> None:
        self.mean, self.modes, self.deviations, self.grid = mean, modes, deviations, grid
        self.facts = {} if facts is None else facts

    def map(self, theta: Any) -> SDM:
        """The map of theta (M,) or its first numbers, in standard deviations."""
        theta = torch.as_tensor(theta, dtype=torch.float32, device=self.mean.device)
        if theta.ndim != 1 or len(theta) > len(self.modes):
            raise MeshError(f"theta has shape {tuple(theta.shape)}; this model takes up to {len(self.modes)} numbers")
        weights = theta * self.deviations[: len(theta)]
        return SDM(self.mean + torch.einsum("m,mxyz->xyz", weights, self.modes[: len(theta)]), self.grid)

    def project(self, values: Tensor) -> Tensor:
        """theta (M,) of the map nearest to values (nx,ny,nz)."""
        return self.modes.flatten(1) @ (values - self.mean).reshape(-1) / self.deviations.clamp_min(1e-30)

    def save(self, path: str | Path) -> None:
        """Write the model as .npz."""
        arrays = {"mean": self.mean, "modes": self.modes, "deviations": self.deviations}
        content: dict[str, Any] = {name: value.cpu().numpy() for name, value in arrays.items()}
        content |= {"origin": np.array(self.grid.origin), "spacing": np.array(self.grid.spacing)}
        write_arrays(as_path(path), content, KIND, self.facts)

    @classmethod
    def load(cls, path: str | Path) -> SDMModes:
        """The model of a file.

        Raises:
            FormatError: It cannot be read, or is something else.
        """
        arrays, facts = read_arrays(as_path(path), KIND, ARRAYS)
        mean, modes, deviations = (torch.from_numpy(arrays[n]).float() for n in ARRAYS[:3])
        if mean.ndim != 3 or modes.shape[1:] != mean.shape or deviations.shape != modes.shape[:1]:
            raise FormatError(f"{path} holds no sound model: its arrays do not fit together")
        return cls(mean, modes, deviations, Grid(arrays["origin"], arrays["spacing"], mean.shape), facts)


def build_sdm_modes(
    meshes: Sequence[TriangleMesh],
    *,
    scale: bool = False,
    modes: int | None = None,
    resolution: int = RESOLUTION,
    device: torch.device | str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SDMModes:
    """Principal components of the exact maps of meshes, each laid onto the first as a whole.

    Args:
        meshes: Three or more closed meshes that face roughly alike.
        scale: Take sizes out.
        modes: How many; by default those that hold 98 % of the variance.
        resolution: Voxels along the longest edge of the grid.
        device: Where to work.
        progress: Called with the number of meshes done and of all.

    Raises:
        GridError: Another resolution than a number of voxels.
        MeshError: Too few meshes, or more modes than they have.
    """
    if len(meshes) < 3:
        raise MeshError(f"a shape model needs three meshes or more, not {len(meshes)}")
    if modes is not None and not 1 <= modes < len(meshes):
        raise MeshError(f"{modes} modes of {len(meshes)} meshes were requested; give 1 to {len(meshes) - 1}")
    where = choose_device(device)
    check_resolution(resolution)
    placed = place_alike(meshes, where, scale=scale)
    every = torch.cat([mesh.vertices for mesh in placed])
    grid = Grid.around(TriangleMesh(every, placed[0].faces, check=False), resolution=resolution, margin=0.1)
    maps = []
    for number, mesh in enumerate(placed):
        maps.append(signed_distance_map(mesh, grid, device=where).values)
        if progress is not None:
            progress(number + 1, len(placed))
    return modes_of(torch.stack(maps), grid, modes, {"shapes": [{"name": m.name} for m in meshes], "scale": scale})


def modes_of(maps: Tensor, grid: Grid, modes: int | None, facts: dict[str, Any]) -> SDMModes:
    """Principal components of maps (N,nx,ny,nz) on a grid, by the method of snapshots."""
    mean = maps.mean(0)
    flat = (maps - mean).flatten(1).double()
    energy, vectors = torch.linalg.eigh(flat @ flat.T)
    energy, vectors = energy.flip(0)[:-1].clamp_min(0), vectors.flip(1)[:, :-1]
    deviations = (energy / (len(maps) - 1)).sqrt()
    shares = compactness(deviations)
    kept = min(int((shares < SHARE).sum()) + 1, len(shares)) if modes is None else modes
    basis = vectors[:, :kept].T @ flat
    basis = (basis / basis.norm(dim=1, keepdim=True).clamp_min(1e-30)).float().reshape(kept, *mean.shape)
    facts = {**facts, "compactness": [round(x, 6) for x in shares.tolist()]}
    return SDMModes(mean, basis, deviations[:kept].float(), grid, facts)


def place_alike(meshes: Sequence[TriangleMesh], device: torch.device, *, scale: bool = False) -> list[TriangleMesh]:
    """Meshes moved and turned, and scaled if asked, so as to lie on the first."""
    layer = TemplateLayer(even_template(meshes[0], TRIANGLES, device), device)
    rest = layer.rest.double()
    placed = []
    for mesh in meshes:
        there = layer.placed(mesh).double()
        a, b = there - there.mean(0), rest - rest.mean(0)
        factor = (b.norm() / a.norm()) if scale else 1.0
        vertices = (mesh.vertices.detach().to(device).double() - there.mean(0)) @ rotations(a[None], b)[0]
        moved = (vertices * factor + rest.mean(0)).float()
        placed.append(TriangleMesh(moved, mesh.faces.to(device), mesh.name, check=False))
    return placed
