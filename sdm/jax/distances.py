"""Functions of JAX arrays: torch's engine on JAX's memory and stream, and its derivatives by rules of JAX's."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import cache, partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.core.as_grid import as_grid
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.to_libraries import imported
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import MeshError, SDMError

# By its name, as this package has the same.
_jax: Any = imported("jax", "jax")
_jnp: Any = imported("jax.numpy", "jax")

Sign = Literal["winding", "none"]
# Types by which Warp takes JAX's arrays.
if TYPE_CHECKING:
    Values = Rows = WholeRows = Volume = Any
else:
    Values, Volume = wp.array(dtype=wp.float32), wp.array3d(dtype=wp.float32)
    Rows, WholeRows = wp.array2d(dtype=wp.float32), wp.array2d(dtype=wp.int32)


def signed_distance(vertices: Any, faces: Any, points: Any, *, sign: Sign = "winding") -> Any:
    """Exact signed distances (...) float32 of points from a mesh, negative inside, as `sdm.signed_distance`.

    Args:
        vertices: (V,3), taken as float32; differentiable.
        faces: (F,3), taken as int32, counter-clockwise seen from outside.
        points: (...,3), taken as float32; differentiable.
        sign: "winding", or "none" for distances of at least 0.

    Raises:
        MeshError: Arrays of other shapes. Faces that name vertices that are not there are found when it runs.
        SDMError: Another sign.
    """
    vertices, faces = _mesh(vertices, faces)
    points = _jnp.asarray(points, _jnp.float32)
    if points.ndim == 0 or points.shape[-1] != 3:
        raise MeshError(f"the points have shape {points.shape}; (..., 3) is needed")
    shape = points.shape[:-1]
    if points.size == 0:
        return _jnp.zeros(shape, _jnp.float32)
    return _points(_known(sign), vertices, faces, points.reshape(-1, 3)).reshape(shape)


def signed_distance_map(vertices: Any, faces: Any, grid: Any, *, sign: Sign = "winding") -> Any:
    """The exact signed distance map (nx,ny,nz) float32 of a mesh, as `sdm.signed_distance_map` measures it.

    Args:
        vertices: (V,3), taken as float32; differentiable.
        faces: (F,3), taken as int32.
        grid: A `Grid`, an image or the path of one; it is fixed when a function is traced.
        sign: "winding" or "none".

    Raises:
        MeshError: Arrays of other shapes.
        GridError: What is given is no grid, or a resolution, which would need to know the vertices.
        SDMError: Another sign.
    """
    vertices, faces = _mesh(vertices, faces)
    return _map(_known(sign), as_grid(grid), vertices, faces)


def _mesh(vertices: Any, faces: Any) -> tuple[Any, Any]:
    vertices, faces = _jnp.asarray(vertices, _jnp.float32), _jnp.asarray(faces, _jnp.int32)
    for name, array in (("vertices", vertices), ("faces", faces)):
        if array.ndim != 2 or array.shape[1] != 3 or not len(array):
            raise MeshError(f"the {name} have shape {array.shape}; (N, 3) with at least one row is needed")
    return vertices, faces


def _known(sign: Any) -> str:
    if sign not in ("winding", "none"):
        raise SDMError(f"the sign {sign!r} is not there for JAX: choose 'winding' or 'none'")
    return sign


@partial(_jax.custom_vjp, nondiff_argnums=(0,))
def _points(sign: str, vertices: Any, faces: Any, points: Any) -> Any:
    return _points_call(sign)(vertices, faces, points, output_dims={"out": points.shape[0]})[0]


def _points_forward(sign: str, vertices: Any, faces: Any, points: Any) -> Any:
    return _points(sign, vertices, faces, points), (vertices, faces, points)


def _points_backward(sign: str, kept: Any, flow: Any) -> Any:
    vertices, faces, points = kept
    shapes = {"to_vertices": vertices.shape, "to_points": points.shape}
    to_vertices, to_points = _points_back(sign)(vertices, faces, points, flow, output_dims=shapes)
    return to_vertices, _no_gradient(faces), to_points


@partial(_jax.custom_vjp, nondiff_argnums=(0, 1))
def _map(sign: str, grid: Grid, vertices: Any, faces: Any) -> Any:
    return _map_call(sign, grid)(vertices, faces, output_dims={"out": grid.shape})[0]


def _map_forward(sign: str, grid: Grid, vertices: Any, faces: Any) -> Any:
    return _map(sign, grid, vertices, faces), (vertices, faces)


def _map_backward(sign: str, grid: Grid, kept: Any, flow: Any) -> Any:
    vertices, faces = kept
    shapes = {"to_vertices": vertices.shape}
    return _map_back(sign, grid)(vertices, faces, flow, output_dims=shapes)[0], _no_gradient(faces)


_points.defvjp(_points_forward, _points_backward)
_map.defvjp(_map_forward, _map_backward)


def _no_gradient(faces: Any) -> Any:
    # Whole numbers have gradients of a type without values.
    return np.zeros(faces.shape, _jax.dtypes.float0)


@cache
def _points_call(sign: Any) -> Any:
    def points_call(
        vertices: Rows,
        faces: WholeRows,
        points: Rows,
        out: Values,
    ) -> None:
        with _torch_stream(out):
            index = _index(_tensor(vertices), faces)
            _tensor(out).copy_(index.signed_distance(_tensor(points), sign=sign))

    return _callable(points_call, 1)


@cache
def _points_back(sign: Any) -> Any:
    def points_back(
        vertices: Rows,
        faces: WholeRows,
        points: Rows,
        flow: Values,
        to_vertices: Rows,
        to_points: Rows,
    ) -> None:
        with _torch_stream(flow), torch.enable_grad():
            moved, at = _tensor(vertices).requires_grad_(), _tensor(points).requires_grad_()
            values = _index(moved, faces).signed_distance(at, sign=sign)
            grads = torch.autograd.grad(values, (moved, at), _tensor(flow))
            _tensor(to_vertices).copy_(grads[0])
            _tensor(to_points).copy_(grads[1])

    return _callable(points_back, 2)


# Grids are few; each compiled function keeps its own.
@cache
def _map_call(sign: Any, grid: Grid) -> Any:
    def map_call(
        vertices: Rows,
        faces: WholeRows,
        out: Volume,
    ) -> None:
        with _torch_stream(out):
            index = _index(_tensor(vertices), faces)
            _tensor(out).copy_(index.signed_distance_map(grid, sign=sign).values)

    return _callable(map_call, 1)


@cache
def _map_back(sign: Any, grid: Grid) -> Any:
    def map_back(
        vertices: Rows,
        faces: WholeRows,
        flow: Volume,
        to_vertices: Rows,
    ) -> None:
        with _torch_stream(flow), torch.enable_grad():
            moved = _tensor(vertices).requires_grad_()
            values = _index(moved, faces).signed_distance_map(grid, sign=sign).values
            _tensor(to_vertices).copy_(torch.autograd.grad(values, moved, _tensor(flow))[0])

    return _callable(map_back, 1)


def _callable(function: Callable[..., None], outputs: int) -> Any:
    """A function of Warp arrays for JAX, which is not recorded: the engine waits for the device in places."""
    return wp.jax_callable(
        function,
        num_outputs=outputs,
        graph_mode=wp.JaxCallableGraphMode.NONE,
        vmap_method="sequential",
        module_preload_mode=wp.JaxModulePreloadMode.NONE,
    )


def _index(vertices: Tensor, faces: Any) -> MeshIndex:
    return MeshIndex(TriangleMesh(vertices, _tensor(faces), "the mesh from JAX"), vertices.device, warn=False)


def _tensor(array: Any) -> Tensor:
    return wp.to_torch(array, requires_grad=False)


def _torch_stream(array: Any) -> AbstractContextManager[Any]:
    """Torch on the stream that JAX runs the call on."""
    if not array.device.is_cuda:
        return nullcontext()
    device = wp.device_to_torch(array.device)
    stream = torch.cuda.ExternalStream(wp.get_stream(array.device).cuda_stream, device)
    return torch.cuda.stream(stream)
