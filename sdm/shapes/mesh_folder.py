"""A family from a folder of meshes: each sample is one of them, warped, scaled, turned and shifted."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.demo_mesh import demo_mesh
from sdm.core.given_values import real, two_numbers
from sdm.core.mesh import TriangleMesh
from sdm.errors import MeshError, SDMError
from sdm.kernels.shapes import warped
from sdm.shapes.family import Family, Group, Parameter, as_theta
from sdm.shapes.triage import reason_to_reject
from sdm.shapes.vertex_op import vertex_op

if TYPE_CHECKING:
    from sdm.engine.arguments import Orient, Sign

# Half a wave of the warp spans a mesh of half-length 1, so it bends a shape as a whole.
FREQUENCY = math.pi / 2
# With every coefficient within [-1,1] this amplitude makes the warp's Lipschitz bound exactly 1.
AMPLITUDE = 1 / (3 * math.sqrt(2) * FREQUENCY)
LARGEST_WARP = 0.95
# What float32 may put a vertex out of place by, as a share of its largest coordinate.
ROUNDING = 1e-6

_warped_vertices = vertex_op(
    "warped_vertices",
    warped.warped_vertices,
    warped.warped_gradient,
    (wp.vec3, wp.int32, wp.vec3, wp.float32, wp.float32),
)


class MeshFolder(Family):
    """Your own closed meshes, varied at random.

    Args:
        source: A folder, whose mesh files, also those of the folders in it, are read in order of their paths, or a
            sequence of meshes of any kind that `as_mesh` takes.
        normalize: Put each mesh's box about the origin with its longest edge 2 long; otherwise each stays where it is.
        rotation: Largest angle of the random rotation [degrees]; None for all rotations alike.
        scale: Least and greatest factor.
        shift: Largest shift along each axis, as a share of the mesh's half-length (half its box's longest edge).
        warp: How far a smooth, low-order warp may bend: a bound on the Lipschitz constant of its displacement, from 0
            to 0.95. Below 1 the map of space is a diffeomorphism whose Jacobian determinant is at least
            (1 - warp)^3, so it never folds a surface through itself. Corners are moved and triangles stay flat: where
            two sheets are closer than their triangles are long, a strong warp can still make them meet.
        open_meshes: "reject" meshes with holes or turned faces, whose inside would not be defined, or "keep" them; by
            default they are rejected where `sign` is "winding".
        orient: How each mesh is turned outward, as for `sdm.signed_distance_map`: "auto" by its components, "parts" by
            what sees each patch of its faces from outside, or "keep", not at all.
        skip_bad: Go on without the files that cannot be used. `rejected` lists them with the reason either way.
        split: Of a folder that `sdm split` has split, the part to use, such as "train": streams of two parts never
            show the same shape.
        sign: The sign that maps of the meshes are to have, which says which meshes can be used; give the stream the
            same. "flood" and "none" take doubled walls and faces that look inwards too.

    Attributes:
        meshes: Those that are used, turned outward as `orient` says.
        rejected: (name, reason) of each file that is not; of a file its path below the folder.

    Parameters (26): `mesh`, whose whole part is the number of the mesh; `scale`; three of the rotation; three of the
    shift; 18 coefficients of the warp.

    Samples have different faces, in one of two layouts. `vertices` and `faces` hold all the meshes of the folder side
    by side; in each sample all but one shrink to a point on the surface of that one, where their triangles change
    neither distance nor winding number. This works wherever fixed faces do, and costs the triangles of the whole
    folder. `groups` splits a batch by mesh instead, and costs each sample its own triangles alone.

    Raises:
        MeshError: No usable mesh, a file that is not usable (unless `skip_bad`), or a range that makes no sense.
    """

    name = "mesh-folder"
    places_meshes = True
    needs_files = True

    def __init__(
        self,
        source: str | Path | Sequence[MeshLike],
        *,
        normalize: bool = True,
        rotation: float | None = None,
        scale: tuple[float, float] = (0.9, 1.1),
        shift: float = 0.1,
        warp: float = 0.5,
        open_meshes: str | None = None,
        orient: Orient = "auto",
        skip_bad: bool = False,
        split: str | None = None,
        sign: Sign = "winding",
    ) -> None:
        self.parameters = _parameters(rotation, scale, shift, warp)
        if open_meshes not in ("reject", "keep", None):
            raise MeshError(f"open_meshes is {open_meshes!r}; use 'reject' or 'keep'")
        keep_open = open_meshes == "keep" if open_meshes is not None else sign != "winding"
        self.meshes, self.rejected = _read(source, orient, split, keep_open=keep_open, sign=sign)
        if self.rejected and not (skip_bad and self.meshes):
            name, reason = self.rejected[0]
            others = f" (and {len(self.rejected) - 1} more)" if len(self.rejected) > 1 else ""
            if skip_bad:
                raise MeshError(f"there is no mesh to use: {name} cannot be used: {reason}{others}")
            raise MeshError(f"{name} cannot be used: {reason}{others}; mend it, or go on without it by skip_bad=True")
        if not self.meshes:
            raise MeshError(f"there is no mesh to use in {source}; put mesh files there (.ply, .stl, .obj, .off, .glb)")
        count = Parameter("mesh", 0.0, float(len(self.meshes)))
        self.parameters = (count, *self.parameters)

        sizes = [len(m.vertices) for m in self.meshes]
        first = np.concatenate([[0], np.cumsum(sizes)])
        self._sizes = sizes
        self.triangles = torch.cat([m.faces + int(first[i]) for i, m in enumerate(self.meshes)])
        uniform = 0.0 if rotation is None else 1.0
        shared = [
            torch.stack([m.vertices[int(m.faces[0, 0])] for m in self.meshes]),
            torch.tensor([_frame(m, normalize) for m in self.meshes], dtype=torch.float32, device="cpu"),
            torch.tensor([AMPLITUDE, FREQUENCY, uniform], dtype=torch.float32, device="cpu"),
        ]
        owner = torch.repeat_interleave(
            torch.arange(len(sizes), dtype=torch.int32, device="cpu"), torch.tensor(sizes, device="cpu")
        )
        rest = torch.cat([m.vertices for m in self.meshes])
        self._tables = [rest, owner, *shared]

    def bounds(self) -> tuple[Tensor, Tensor]:
        """Lowest and highest x, y, z (3,) of all meshes over the whole box of parameters: reached, but for rounding.

        Where rotations are limited, it is as if each could be about any axis.
        """
        high = [p.high for p in self.parameters]
        turn = high[warped.ROTATION : warped.SHIFT]
        frames, constants = self._tables[3].double(), self._tables[4]
        angle = math.hypot(*turn) if float(constants[2]) > 0 else math.pi
        lows, highs = [], []
        for mesh, frame in zip(self.meshes, frames, strict=True):
            points = mesh.vertices[mesh.faces.unique().long()].double()
            reach = _reach((points - frame[:3]) / frame[3], high[warped.SINES], angle)
            reach = frame[7] * (high[warped.SCALE] * reach + high[warped.SHIFT])
            lows.append(frame[4:7] - reach[1])
            highs.append(frame[4:7] + reach[0])
        ends = torch.stack([torch.stack(lows).amin(0), torch.stack(highs).amax(0)])
        room = ROUNDING * ends.abs().amax()
        return (ends[0] - room).float(), (ends[1] + room).float()

    def vertices(self, theta: Tensor) -> Tensor:
        """Vertices (B,V,3) of all meshes for theta (B,26): one mesh a sample, the others shrunk to a point of it."""
        theta = as_theta(theta, len(self.parameters), self.name)
        tables = self._on(theta.device, "tables", lambda: self._tables)
        return _warped_vertices(theta, tables, tables[0].shape[0])

    @property
    def triangles_per_sample(self) -> int:
        """Mean number of triangles of a mesh, as each comes about equally often."""
        return max(1, len(self.triangles) // len(self.meshes))

    def probes(self, theta: Tensor) -> list[Tensor]:
        """theta (B,26) with each mesh of the folder in turn."""
        each = []
        for number in range(len(self.meshes)):
            own = theta.clone()
            own[:, 0] = number + 0.5
            each.append(own)
        return each

    def groups(self, theta: Tensor, host: Tensor | None = None) -> Iterator[Group]:
        """The batch split by mesh, each group with that mesh's faces alone.

        Without `host`, theta on the host, this waits for the device.
        """
        theta = as_theta(theta, len(self.parameters), self.name)
        known = theta.detach().cpu() if host is None else host
        which = known[:, 0].floor().long().clamp(0, len(self.meshes) - 1)
        for number in which.unique().tolist():
            rows = (which == number).nonzero().squeeze(1).to(theta.device, non_blocking=True)
            tables = self._on(theta.device, f"tables {number}", partial(self._tables_of, number))
            faces = self._on(theta.device, f"faces {number}", partial(self._faces_of, number))[0]
            yield Group(rows, _warped_vertices(theta[rows], tables, tables[0].shape[0]), faces)

    def sample_transforms(self, theta: Tensor) -> Tensor:
        """Matrices (B,4,4) float64 of each sample's scale, rotation and shift; the smooth warp comes before them."""
        plain = theta.clone()
        plain[:, warped.SINES :] = 0
        _, _, anchors, frames, constants = self._tables
        which = theta[:, 0].floor().long().clamp(0, len(self.meshes) - 1)
        found = torch.empty(theta.shape[0], 4, 4, dtype=torch.float64, device="cpu")
        for number in which.unique().tolist():
            rows = which == number
            centre, half = frames[number, :3], frames[number, 3]
            # An affine map is known by where it takes a point and three steps from it.
            points = torch.cat([centre[None], centre + half * torch.eye(3, dtype=torch.float32, device="cpu")])
            owner = torch.full((4,), number, dtype=torch.int32, device="cpu")
            moved = _warped_vertices(plain[rows], [points, owner, anchors, frames, constants], 4).double()
            linear = (moved[:, 1:] - moved[:, :1]).transpose(1, 2) / half.double()
            matrix = torch.eye(4, dtype=torch.float64, device="cpu").repeat(int(rows.sum()), 1, 1)
            matrix[:, :3, :3] = linear
            matrix[:, :3, 3] = moved[:, 0] - linear @ centre.double()
            found[rows] = matrix
        return found

    @classmethod
    def example(cls) -> MeshFolder:
        """Two small meshes."""
        return cls([demo_mesh(rings=41, segments=16, cap_rings=3), demo_mesh(rings=21, segments=12, cap_rings=2)])

    def _tables_of(self, number: int) -> list[Tensor]:
        begin = sum(self._sizes[:number])
        end = begin + self._sizes[number]
        rest, owner, *shared = self._tables
        return [rest[begin:end].contiguous(), owner[begin:end].contiguous(), *shared]

    def _faces_of(self, number: int) -> list[Tensor]:
        return [self.meshes[number].faces]


def _reach(points: Tensor, warp: float, angle: float) -> Tensor:
    """Reach (2,3) along the axes and against them of points (V,3), warped and then turned by at most `angle`."""
    wave = FREQUENCY * points
    # Each coordinate has coefficients of its own, so a point may come to any corner of a cube around it.
    by = AMPLITUDE * warp * (wave.sin().abs() + wave.cos().abs()).sum(1, keepdim=True)
    signs = torch.tensor(list(itertools.product((-1.0, 1.0), repeat=3)), dtype=torch.float64, device="cpu")
    corners = (points + by * signs[:, None]).reshape(-1, 3)
    length = corners.norm(dim=1, keepdim=True)
    cosine = torch.stack([corners, -corners]) / length.clamp_min(1e-30)
    return (length * (cosine.clamp(-1, 1).acos() - angle).clamp_min(0).cos()).amax(1)


def _parameters(rotation: float | None, scale: tuple[float, float], shift: float, warp: float) -> tuple[Parameter, ...]:
    least, most = two_numbers(scale)
    if not 0 < least <= most < math.inf:
        raise MeshError(f"the scale is {scale!r}; give two positive factors, the lower first")
    if not 0 <= real(shift) < math.inf:
        raise MeshError(f"the largest shift is {shift!r}; give a share of the mesh of at least 0")
    if not 0 <= real(warp) <= LARGEST_WARP:
        raise MeshError(f"the warp is {warp!r}; give 0 to {LARGEST_WARP}, so that it never folds a mesh")
    if rotation is not None and not 0 <= real(rotation) <= 180:
        raise MeshError(f"the largest rotation is {rotation!r}; give 0 to 180 degrees, or None for all rotations")
    if rotation is None:
        turn = [Parameter(f"u{i}", 0.0, 1.0) for i in (1, 2, 3)]
    else:
        angle = math.radians(rotation) / math.sqrt(3)
        turn = [Parameter(f"turn_{axis}", -angle, angle, "rad") for axis in "xyz"]
    move = [Parameter(f"shift_{axis}", -shift, shift) for axis in "xyz"]
    bend = [Parameter(f"{wave}_{to}{by}", -warp, warp) for wave in ("sin", "cos") for to in "xyz" for by in "xyz"]
    return (Parameter("scale", least, most), *turn, *move, *bend)


def _read(
    source: str | Path | Sequence[MeshLike], orient: Orient, split: str | None, *, keep_open: bool, sign: Sign
) -> tuple[tuple[TriangleMesh, ...], tuple[tuple[str, str], ...]]:
    from sdm.engine.arguments import SignMethod, check_orient, oriented
    from sdm.io import mesh_tree
    from sdm.io.meshes.split_file import files_of_part

    check_orient(orient)
    SignMethod(sign)
    folder = Path()
    if isinstance(source, str | Path):
        folder = Path(source)
        if not folder.is_dir():
            raise MeshError(f"{folder} is not a folder; give a folder of meshes")
        files = mesh_tree(folder)
        items: Sequence[MeshLike] = files if split is None else files_of_part(folder, split, files)
    elif split is not None:
        raise MeshError(f"a sequence of meshes has no part {split!r}: give a folder that sdm split has split")
    elif isinstance(source, Iterable) and not isinstance(source, bytes):
        items = list(source)
    else:
        raise MeshError(f"an object of type {type(source).__name__} is no folder and no list of meshes: give one")
    meshes, rejected = [], []
    for number, item in enumerate(items):
        if isinstance(item, str | Path):
            name = Path(item).relative_to(folder).as_posix() if isinstance(source, str | Path) else str(item)
        else:
            name = item.name if isinstance(item, TriangleMesh) else f"mesh {number}"
        try:
            mesh = as_mesh(item).to("cpu")
            # On the host, so that the same meshes come of it whatever the device.
            mesh = oriented(mesh, orient, mesh.device)
            why = reason_to_reject(mesh, keep_open=keep_open, sign=sign)
        except (SDMError, OSError) as error:
            why = str(error)
        if why is None:
            meshes.append(mesh)
        else:
            rejected.append((name, why))
    return tuple(meshes), tuple(rejected)


def _frame(mesh: TriangleMesh, normalize: bool) -> list[float]:
    low, high = mesh.bounds
    centre, half = (low + high) / 2, float((high - low).max()) / 2
    return [*centre, half, *([0, 0, 0, 1] if normalize else [*centre, half])]
