"""The triangle mesh that every distance is measured to."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Float32, Float64, Int32
from torch import Tensor

from sdm.core.device import device_to_hold
from sdm.core.to_libraries import mesh_to_open3d, mesh_to_pyvista, mesh_to_trimesh
from sdm.errors import MeshError

# Squared lengths, areas and volumes of a mesh within this bound stay finite in float64, lengths in float32.
LARGEST_COORDINATE = float(np.float32(1e30))
# Kernels count up to 20 numbers a triangle with 32 bits.
MOST_TRIANGLES = 100_000_000


@dataclass(frozen=True, eq=False, repr=False)
class TriangleMesh:
    """A triangle mesh.

    Args:
        vertices: (V,3) coordinates in any one unit of length (millimetres for anatomy); NumPy, torch or
            anything with DLPack. Kept as a float32 tensor on its device, without a copy where it is one already.
        faces: (F,3) vertex indices, counter-clockwise seen from outside. Kept as an int32 tensor, which may share the
            memory of what was given: who writes into a NumPy array afterwards needs a new mesh, as what faces say is
            remembered.
        name: What messages call it, for example the file's name.
        check: Look for values that are not finite and for indices out of range. On a GPU this waits for the
            device, so a caller that made the arrays itself may turn it off.

    Raises:
        MeshError: No triangles, wrong shapes, NaN or infinite vertices, or a face index out of range.

    Zero-area and repeated faces are welcome: every triangle counts. `inspect_mesh` tells what a mesh is like.
    """

    vertices: Float32[Tensor, "V 3"]
    faces: Int32[Tensor, "F 3"]
    name: str = "mesh"
    check: bool = True

    if TYPE_CHECKING:  # what may be given is wider than what is kept

        def __init__(self, vertices: Any, faces: Any, name: str = "mesh", check: bool = True) -> None: ...

    def __post_init__(self) -> None:
        vertices = as_tensor(self.vertices, torch.float32, f"the vertices of {self.name}")
        faces = as_tensor(self.faces, torch.int32, f"the faces of {self.name}", device=vertices.device)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
        _check_shapes(vertices, faces, self.name)
        if self.check:
            _check_values(vertices, faces, self.name)

    def __len__(self) -> int:
        return self.faces.shape[0]

    def __repr__(self) -> str:
        return f"TriangleMesh({self.name}: {len(self):,} triangles, {len(self.vertices):,} vertices, on {self.device})"

    @property
    def device(self) -> torch.device:
        """The device of vertices and faces."""
        return self.vertices.device

    @property
    def bounds(self) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]]:
        """Lowest and highest x, y, z over the vertices that faces use, float64 (3,) each."""
        places, numbers = plain_array(self.vertices), plain_array(self.faces)
        if places is not None and numbers is not None:
            # Vertices once, and axis by axis: NumPy takes ten times as long along the short axis of all corners.
            used = np.zeros(len(places), bool)
            used[numbers.ravel()] = True
            placed = np.ascontiguousarray(places.T if used.all() else places[used].T)
            return placed.min(1).astype(np.float64), placed.max(1).astype(np.float64)
        used = self.vertices.detach()[self.faces.reshape(-1).long()]
        low, high = used.amin(0), used.amax(0)
        return low.cpu().double().numpy(), high.cpu().double().numpy()

    def to(self, device: torch.device | str) -> TriangleMesh:
        """The same mesh on another device: itself where it is there already.

        Raises:
            DeviceError: There is none of that name.
        """
        if not isinstance(device, torch.device):
            device = device_to_hold(device)
        if self.vertices.device == device:
            return self
        return TriangleMesh(self.vertices.to(device), self.faces.to(device), self.name, check=False)

    def flipped(self) -> TriangleMesh:
        """The same mesh inside out: each face's vertices in the other order."""
        return TriangleMesh(self.vertices, self.faces.flip(1).contiguous(), self.name, check=False)

    def save(self, path: str | Path) -> None:
        """Write to a file whose name's ending is the format, as `sdm.save_mesh` does; atomic.

        Raises:
            FormatError: Another ending, or a place that cannot be written.
        """
        from sdm.io import save_mesh

        save_mesh(self, path)

    def to_trimesh(self) -> Any:
        """A `trimesh.Trimesh` with the same vertices and faces."""
        return mesh_to_trimesh(self)

    def to_open3d(self) -> Any:
        """An `open3d.geometry.TriangleMesh` with the same vertices and faces."""
        return mesh_to_open3d(self)

    def to_pyvista(self) -> Any:
        """A `pyvista.PolyData` with the same vertices and faces."""
        return mesh_to_pyvista(self)

    def numpy(self) -> tuple[Float32[np.ndarray, "V 3"], Int32[np.ndarray, "F 3"]]:
        """Vertices (V,3) float32 and faces (F,3) int32 on the host."""
        return self.vertices.detach().cpu().numpy(), self.faces.cpu().numpy()


_NUMPY_TYPES = {torch.float32: np.float32, torch.float64: np.float64, torch.int32: np.int32, torch.int64: np.int64}


def as_tensor(array: Any, dtype: torch.dtype, what: str, device: torch.device | None = None) -> Tensor:
    """`array` as a tensor of `dtype`, sharing memory where dtype, device and layout allow it.

    Args:
        array: A tensor, a NumPy array, anything with DLPack, or nested lists of numbers.
        dtype: Wanted type. Integers too large for it are an error, never wrapped around.
        what: What messages call it.
        device: Where it is wanted; where it is already if None.
    """
    if isinstance(array, Tensor):
        tensor = array
    elif hasattr(array, "__dlpack__") and not isinstance(array, np.ndarray):
        tensor = torch.from_dlpack(array)
    else:
        host = _host_array(array, what)
        # torch cannot hold views with negative strides, foreign byte orders or read-only memory safely, and no fields
        # of packed records, as of PLY and STL files.
        if not host.flags.writeable or not host.dtype.isnative or any(s < 0 or s % host.itemsize for s in host.strides):
            host = np.array(host, dtype=host.dtype.newbyteorder("="), order="C")
        tensor = torch.from_numpy(host)
    if tensor.is_complex() or tensor.dtype == torch.bool:
        raise MeshError(f"{what} hold {tensor.dtype} values; give an array of numbers")
    if not dtype.is_floating_point:
        if tensor.dtype.is_floating_point and tensor.numel():
            raise MeshError(f"{what} hold {tensor.dtype} values; give integers")
        # Torch compares few unsigned integers, and too large ones would wrap around.
        if tensor.dtype in (torch.uint16, torch.uint32, torch.uint64):
            tensor = tensor.to(torch.int64)
        if tensor.dtype == torch.int64 and tensor.numel():
            host = plain_array(tensor)
            # Without torch's threads, which take longer to meet.
            low, high = torch.stack(tensor.aminmax()).tolist() if host is None else (int(host.min()), int(host.max()))
            if low < -(2**31) or high >= 2**31:
                raise MeshError(f"{what} hold the index {high if high >= 2**31 else low}, which is out of range")
    if tensor.dtype != dtype and not tensor.requires_grad and (device is None or device.type == "cpu"):
        host = plain_array(tensor)
        if host is not None:
            with np.errstate(over="ignore"):
                # As above.
                return torch.from_numpy(host.astype(_NUMPY_TYPES[dtype], order="C"))
    return tensor.to(device=device, dtype=dtype).contiguous()


def plain_array(tensor: Tensor) -> np.ndarray | None:
    """The memory of a tensor on the host as an array; None of any other tensor, and where a compiler watches."""
    if tensor.device.type != "cpu" or type(tensor) is not Tensor or torch.compiler.is_compiling():
        return None
    try:
        return tensor.detach().numpy()
    except (RuntimeError, TypeError):
        # Of a transform such as vmap, or of a type that NumPy has not.
        return None


def _host_array(array: Any, what: str) -> np.ndarray:
    try:
        host = np.asarray(array)
    except ValueError as error:
        raise MeshError(f"{what} are rows of different lengths; give an array of numbers") from error
    if host.dtype.kind not in "fiu":
        raise MeshError(f"{what} hold {host.dtype} values; give an array of numbers")
    return host.astype(np.float64) if host.dtype == np.longdouble else host


def _turned(array: Tensor) -> str:
    """Said of an array that has rows for columns."""
    return ": transpose it" if array.ndim == 2 and array.shape[0] == 3 else ""


def _check_shapes(vertices: Tensor, faces: Tensor, name: str) -> None:
    if faces.numel() == 0 or vertices.numel() == 0:
        raise MeshError(f"{name} has no triangles; give a surface mesh, not points or lines")
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise MeshError(
            f"the vertices of {name} have shape {tuple(vertices.shape)}; (V, 3) is needed{_turned(vertices)}"
        )
    if faces.ndim != 2 or faces.shape[1] != 3:
        meant = _turned(faces) or ": triangulate first"
        raise MeshError(f"the faces of {name} have shape {tuple(faces.shape)}; (F, 3) is needed{meant}")
    if faces.shape[0] > MOST_TRIANGLES:
        raise MeshError(f"{name} has {faces.shape[0]:,} triangles; at most {MOST_TRIANGLES:,} are supported: split it")


def _check_values(vertices: Float32[Tensor, "V 3"], faces: Int32[Tensor, "F 3"], name: str) -> None:
    count = vertices.shape[0]
    places, numbers = plain_array(vertices), plain_array(faces)
    if places is None or numbers is None:
        # All numbers in one copy: each would wait for a GPU. The largest is NaN if any coordinate is.
        bounds = (*faces.aminmax(), vertices.detach().abs().amax())
        low, high, largest = torch.stack([bound.double() for bound in bounds]).tolist()
    else:
        low, high = int(numbers.min()), int(numbers.max())
        largest = float(np.maximum(places.max(), -places.min()))
    if low < 0 or high >= count:
        bad = int(low if low < 0 else high)
        meant = "; they seem to be counted from 1, as in OBJ files: subtract 1" if low == 1 and high == count else ""
        raise MeshError(
            f"a face of {name} uses vertex {bad}, but its {count} vertices are numbered 0 to {count - 1}{meant}"
        )
    # A NaN in a vertex that no face uses cannot matter, yet it tells of a damaged file.
    if not math.isfinite(largest):
        index = int((~torch.isfinite(vertices.detach()).all(1)).nonzero()[0])
        raise MeshError(f"vertex {index} of {name} is {vertices[index].tolist()}; every coordinate must be finite")
    if largest > LARGEST_COORDINATE:
        raise MeshError(
            f"a coordinate of {name} is {largest:g}; at most {LARGEST_COORDINATE:g} is supported: use a larger unit"
        )
