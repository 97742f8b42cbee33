"""mesh_to_sdf: `mesh_to_sdf`, `mesh_to_voxels`, `sample_sdf_near_surface`. Negative inside, float32.

Arguments about scans, point clouds and their normals are taken and not used: distances are to the surface itself, and
its signs by winding numbers, so that there is no resolution to choose.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from sdm.core.as_mesh import as_mesh
from sdm.core.given_values import whole
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.random import derive_seed
from sdm.engine.mesh_index import MeshIndex
from sdm.engine.points import PointsIndex
from sdm.errors import MeshError, SDMError

# The standard deviations of points about the surface, and the share of all that are.
DEVIATIONS = (0.0025, 0.00025)
NEAR = 47 / 50


class BadMeshException(SDMError):  # noqa: N818
    """A mesh of which less is inside than was asked for."""


def mesh_to_sdf(
    mesh: Any,
    query_points: Any,
    surface_point_method: str = "scan",
    sign_method: str = "normal",
    bounding_radius: float | None = None,
    scan_count: int = 100,
    scan_resolution: int = 400,
    sample_point_count: int = 10_000_000,
    normal_sample_count: int = 11,
    *,
    device: str | torch.device | None = None,
) -> np.ndarray:
    """Signed distances (N,) float32 of points (N,3), negative inside.

    Args:
        mesh: A trimesh mesh or scene, or whatever `sdm.core.as_mesh` takes for a mesh.
        query_points: (N,3).
        surface_point_method: Not used, as all that follow but `device`.
        sign_method: Not used.
        bounding_radius: Not used.
        scan_count: Not used.
        scan_resolution: Not used.
        sample_point_count: Not used.
        normal_sample_count: Not used.
        device: Where to compute; by default a GPU if there is one.

    Raises:
        MeshError: The points are not (N,3), or the mesh is none.
    """
    points = np.asarray(query_points)
    if points.ndim != 2 or points.shape[1] != 3:
        raise MeshError(f"the points have shape {points.shape}; (N, 3) is needed")
    return PointsIndex(as_mesh(mesh), device).signed_distance(points).cpu().numpy()


def mesh_to_voxels(
    mesh: Any,
    voxel_resolution: int = 64,
    surface_point_method: str = "scan",
    sign_method: str = "normal",
    scan_count: int = 100,
    scan_resolution: int = 400,
    sample_point_count: int = 10_000_000,
    normal_sample_count: int = 11,
    pad: bool = False,
    check_result: bool = False,
    return_gradients: bool = False,
    *,
    device: str | torch.device | None = None,
) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
    """The map (n,n,n) float32 of the mesh scaled to the cube from -1 to 1, whose faces hold the outermost voxels.

    Args:
        mesh: As for `mesh_to_sdf`.
        voxel_resolution: n.
        surface_point_method: Not used.
        sign_method: Not used.
        scan_count: Not used.
        scan_resolution: Not used.
        sample_point_count: Not used.
        normal_sample_count: Not used.
        pad: Add a layer of voxels of the value 1 around.
        check_result: Not used: no value can be wrong by more than rounding.
        return_gradients: Also return the unit directions (n,n,n,3) in which the distance grows.
        device: Where to compute; by default a GPU if there is one.
    """
    scaled = scale_to_unit_cube(mesh)
    if whole(voxel_resolution, 1) is None:
        raise SDMError(f"the resolution {voxel_resolution!r} must be a whole number of at least 1")
    step = 2.0 / max(voxel_resolution - 1, 1)
    grid = Grid((-1.0,) * 3, (step,) * 3, (voxel_resolution,) * 3)
    index = MeshIndex(scaled, device, warn=False)
    gradients = None
    if return_gradients:
        field, hit = index.signed_distance_map(grid, return_closest=True)
        gradients = (hit.directions * torch.where(field.values < 0, -1.0, 1.0)[..., None]).cpu().numpy()
        gradients = np.pad(gradients, ((1, 1),) * 3 + ((0, 0),), mode="edge") if pad else gradients
    else:
        field = index.signed_distance_map(grid)
    voxels = field.numpy()
    voxels = np.pad(voxels, 1, constant_values=1) if pad else voxels
    return voxels if gradients is None else (voxels, gradients)


def sample_sdf_near_surface(
    mesh: Any,
    number_of_points: int = 500_000,
    surface_point_method: str = "scan",
    sign_method: str = "normal",
    scan_count: int = 100,
    scan_resolution: int = 400,
    sample_point_count: int = 10_000_000,
    normal_sample_count: int = 11,
    min_size: float = 0,
    return_gradients: bool = False,
    *,
    seed: int | None = None,
    device: str | torch.device | None = None,
) -> tuple[np.ndarray, ...]:
    """Points (N,3) near the surface of the mesh scaled to the unit sphere, and their signed distances (N,), float32.

    As in DeepSDF: 47 of 50 points about random ones of the surface, half of them with a deviation of 0.0025 along each
    axis and half with 0.00025; the others anywhere in the sphere.

    Args:
        mesh: As for `mesh_to_sdf`.
        number_of_points: N.
        surface_point_method: Not used.
        sign_method: Not used.
        scan_count: Not used.
        scan_resolution: Not used.
        sample_point_count: Not used.
        normal_sample_count: Not used.
        min_size: The least share of the sphere that has to be inside.
        return_gradients: Also return the unit directions (N,3) in which the distance grows.
        seed: Of the points; None for others at each call.
        device: Where to compute; by default a GPU if there is one.

    Raises:
        BadMeshException: Less than `min_size` is inside.
    """
    scaled = scale_to_unit_sphere(mesh)
    random = np.random.default_rng(None if seed is None else derive_seed(seed, "samples about a mesh"))
    if whole(number_of_points, 0) is None:
        raise SDMError(f"{number_of_points!r} points were requested; give a whole number of at least 0")
    near = int(number_of_points * NEAR) // 2
    surface = _surface_points(scaled, near, random)
    about = [surface + random.normal(scale=deviation, size=surface.shape) for deviation in DEVIATIONS]
    inner = _in_unit_sphere(number_of_points - 2 * near, random)
    points = np.concatenate([*about, inner]).astype(np.float32)
    index = PointsIndex(scaled, device)
    values, hit = index.signed_distance(points, return_closest=True)
    if min_size > 0 and float((values[2 * near :] < 0).float().mean()) < min_size:
        raise BadMeshException(f"less than {min_size:g} of the unit sphere is inside {scaled.name}: use another mesh")
    found = (points, values.cpu().numpy())
    if not return_gradients:
        return found
    return (*found, (hit.directions * torch.where(values < 0, -1.0, 1.0)[:, None]).cpu().numpy())


def scale_to_unit_cube(mesh: Any) -> TriangleMesh:
    """The mesh moved and scaled so that its box lies about the origin, its longest edge from -1 to 1."""
    whole = as_mesh(mesh)
    low, high = whole.bounds
    return _moved(whole, (low + high) / 2, float((high - low).max()) / 2)


def scale_to_unit_sphere(mesh: Any) -> TriangleMesh:
    """The mesh moved so that its box lies about the origin, and scaled so that the furthest vertex is at distance 1."""
    whole = as_mesh(mesh)
    low, high = whole.bounds
    middle = (low + high) / 2
    used = whole.numpy()[0][np.unique(whole.numpy()[1])]
    return _moved(whole, middle, float(np.linalg.norm(used - middle, axis=1).max()))


def _moved(mesh: TriangleMesh, middle: np.ndarray, length: float) -> TriangleMesh:
    if not length > 0:
        raise MeshError(f"{mesh.name} has size zero and cannot be scaled: give a surface")
    vertices, faces = mesh.numpy()
    return TriangleMesh((vertices - middle) / length, faces, mesh.name)


def _surface_points(mesh: TriangleMesh, count: int, random: np.random.Generator) -> np.ndarray:
    """Random points (N,3) of a mesh, even by area."""
    vertices, faces = mesh.numpy()
    a, b, c = np.moveaxis(vertices.astype(np.float64)[faces], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if not areas.sum() > 0:
        raise MeshError(f"every triangle of {mesh.name} has zero area; points of its surface need some")
    face = random.choice(len(faces), count, p=areas / areas.sum())
    u, v = random.random((2, count, 1))
    root = np.sqrt(u)
    return (1 - root) * a[face] + root * (1 - v) * b[face] + root * v * c[face]


def _in_unit_sphere(count: int, random: np.random.Generator) -> np.ndarray:
    """Random points (N,3), even in the unit sphere."""
    way = random.normal(size=(count, 3))
    return way / np.linalg.norm(way, axis=1, keepdims=True) * random.random((count, 1)) ** (1 / 3)
