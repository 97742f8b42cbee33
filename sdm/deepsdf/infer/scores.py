"""Scores of a surface: the paper's measures, distances in the mesh's unit, and overlap.

The paper's Chamfer distances are not in the unit sphere that its network sees. Its evaluation undoes that normalisation
(`gen_points / scale - offset` in deep_sdf/metrics/chamfer.py of github.com/facebookresearch/DeepSDF at 48c19b8, against
points of meshes that src/SampleVisibleMeshSurface.cpp leaves as they are), so they are in the coordinates of
ShapeNetCore.v2. Those divide each model by the diagonal of its bounding box: the release's own script normalize.py does
(linked from github.com/czq142857/BSP-NET-pytorch, issue 15), and the box measured in
github.com/fwilliams/point-cloud-utils, issue 53, has sides of 0.230, 0.400 and 0.886, a diagonal of 0.999.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import torch
from torch import Tensor

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.grid import Grid
from sdm.core.random import derive_seed
from sdm.deepsdf.infer.paper_measures import PaperMeasures, paper_measures, point_set
from sdm.deepsdf.samples import UnitSphere, surface_points
from sdm.engine.mesh_index import MeshIndex
from sdm.metrics import dice
from sdm.training.training_settings import check_counts

# As J. Park et al., CVPR 2019, section 6.
POINTS = 30_000


@dataclass(frozen=True, kw_only=True)
class ShapeScores(PaperMeasures):
    """Scores of one shape: those of `PaperMeasures` (earth mover's distance, accuracy, completion, normals), and these.

    Args:
        chamfer: 1000 times the sum of both mean squared distances between 30,000 random points of each surface, in
            unit-sphere radii. Between two draws from the same surface it is not 0 but `chamfer_floor`.
        chamfer_floor: The same between two draws from the true surface: what a perfect answer would score.
        chamfer_surface: As `chamfer`, but exactly to the other surface rather than to points of it: 0 if perfect.
        chamfer_paper: `chamfer` in the paper's scale, where the true surface's bounding box has a diagonal of 1.
        chamfer_paper_floor: `chamfer_floor` in that scale.
        diagonal: Of the true surface's bounding box, in unit-sphere radii.
        mean: Mean distance between the surfaces, both ways, in the mesh's unit (mm for anatomy).
        percentile95: 95 % of the points of either surface are within this of the other, in the mesh's unit.
        dice: Overlap of the insides on a grid of voxels around the truth.
    """

    chamfer: float
    chamfer_floor: float
    chamfer_surface: float
    chamfer_paper: float
    chamfer_paper_floor: float
    diagonal: float
    mean: float
    percentile95: float
    dice: float


def chamfer_distance(a: Tensor, b: Tensor) -> float:
    """1000 times the sum of the mean squared distances from points a (N,3) to b (M,3) and back."""
    return 1000 * (_mean_squared(a, b) + _mean_squared(b, a))


def box_diagonal(mesh: MeshLike) -> float:
    """Length of the diagonal of the bounding box of a mesh's triangles, in the mesh's unit."""
    mesh = as_mesh(mesh)
    corners = mesh.vertices.detach()[mesh.faces.reshape(-1).long()].double()
    return float((corners.amax(0) - corners.amin(0)).norm())


def score_shape(
    mesh: MeshLike,
    truth: MeshLike,
    *,
    sphere: UnitSphere | None = None,
    points: int = POINTS,
    seed: int = 0,
    resolution: int = 128,
) -> ShapeScores:
    """Compare a surface with the true one; both in one unit, on the truth's device.

    Args:
        mesh: What was found, as `as_mesh` takes it.
        truth: What is right, likewise.
        sphere: The truth's normalisation, in whose radii Chamfer distances are; its own if not given.
        points: Random points of each surface.
        seed: Of these points.
        resolution: Voxels along each axis of the grid for the overlap.
    """
    mesh, truth = as_mesh(mesh), as_mesh(truth)
    check_counts(points=points)
    sphere = sphere or UnitSphere.of(truth)
    own, index = MeshIndex(mesh, truth.device), MeshIndex(truth, truth.device)
    found, right, again = (
        surface_points(surface, points, seed=derive_seed(seed, "score of a shape", number))[0]
        for number, surface in enumerate((own.mesh, index.mesh, index.mesh))
    )
    there, back = index.signed_distance(found).abs().double(), own.signed_distance(right).abs().double()
    squares = float(there.square().mean() + back.square().mean()) / sphere.radius**2
    grid = Grid.around(truth, resolution=resolution)
    insides = [i.signed_distance_map(grid).values < 0 for i in (own, index)]
    unit = [sphere.to_unit(p) for p in (found, right, again)]
    chamfer, floor = chamfer_distance(unit[0], unit[1]), chamfer_distance(unit[1], unit[2])
    diagonal = box_diagonal(truth) / sphere.radius
    more = paper_measures(own, index, box_diagonal(truth), seed=seed)
    return ShapeScores(
        **asdict(more),
        chamfer=chamfer,
        chamfer_floor=floor,
        chamfer_surface=1000 * squares,
        chamfer_paper=chamfer / diagonal**2,
        chamfer_paper_floor=floor / diagonal**2,
        diagonal=diagonal,
        mean=float(there.mean() + back.mean()) / 2,
        percentile95=float(torch.cat([there, back]).quantile(0.95)),
        dice=dice(*insides),
    )


def _mean_squared(a: Tensor, b: Tensor) -> float:
    # On the host whatever the device: 40 ms, where torch.cdist without a matrix product takes a second on a GPU.
    from scipy.spatial import KDTree

    return float((KDTree(point_set(b)).query(point_set(a))[0] ** 2).mean())
