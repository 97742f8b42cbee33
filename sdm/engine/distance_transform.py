"""Exact Euclidean distance transform of label volumes, of one mask or of many classes, where the tensor is."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, Literal, TypedDict, TypeVar, Unpack, overload

import numpy as np
import torch
from torch import Tensor

from sdm.core.given_values import real
from sdm.engine.edt.nearest_voxels import NearestVoxels, labels_at
from sdm.engine.edt.passes import LANES, MOST_VOXELS, fill_classes, is_class
from sdm.errors import GridError, SDMError
from sdm.kernels.edt.envelopes import LONGEST_LINE
from sdm.runtime.operators import is_eager

# What "surface" means: how far the surface of a voxel is from its centre, in voxels.
SURFACES = {"centres": 0.0, "faces": 0.5}
# Classes by their values, by their number (1 to it), or every value that is there but 0.
Classes = Sequence[int] | int | Literal["all"]
# Attributes of images of other libraries, and what of them a transform takes.
IMAGES = {
    "dataobj": "np.asarray(image.dataobj) and image.header.get_zooms()",
    "GetSpacing": "sitk.GetArrayViewFromImage(image) and image.GetSpacing()[::-1], both z, y, x",
    "spatial_shape": "image.data and image.spacing",
}
A = TypeVar("A", Tensor, np.ndarray)


class TransformOptions(TypedDict, total=False):
    """Signs, ends and classes of a transform, as the overloads share them."""

    signed: bool
    surface: str
    missing: float
    classes: Classes | None


@overload
def euclidean_distance_transform(
    mask: A,
    spacing: float | Sequence[float] = 1.0,
    *,
    out: A | None = None,
    return_nearest: Literal[False] = False,
    **options: Unpack[TransformOptions],
) -> A: ...
@overload
def euclidean_distance_transform(
    mask: A,
    spacing: float | Sequence[float] = 1.0,
    *,
    out: A | None = None,
    return_nearest: Literal[True],
    **options: Unpack[TransformOptions],
) -> tuple[A, NearestVoxels]: ...
def euclidean_distance_transform(
    mask: Any,
    spacing: float | Sequence[float] = 1.0,
    *,
    signed: bool = False,
    surface: str = "centres",
    missing: float = math.inf,
    classes: Classes | None = None,
    out: Any = None,
    return_nearest: bool = False,
) -> Any:
    """Exact distance of every voxel's centre from the foreground of a volume, or from each of its classes.

    Unsigned, a voxel of the foreground has 0 and any other the distance from the nearest foreground voxel; SciPy's
    `distance_transform_edt(a)` is this transform of `a == 0`. Signed, a voxel outside has that same distance and a
    voxel inside minus its distance from the nearest background voxel. What lies beyond the volume is neither. With
    `classes` each class is the foreground in turn and all else background: a map for each, bit for bit that of
    `mask == value`, without a mask for each.

    With `surface="centres"` a distance ends at the other voxel's centre, as in SciPy: two neighbours along an axis
    are one spacing apart, and no signed value lies between minus and plus the smallest spacing. With
    `surface="faces"` it ends at the nearest point of the other voxel's box, so the signed map is that of the surface
    made of voxel faces, and two neighbours across it have minus and plus half a spacing.

    Separable and linear in the number of voxels: A. Meijster, J. Roerdink, W. Hesselink, "A general algorithm for
    computing distance transforms in linear time", 2000. Nothing waits for the device, but for `classes="all"`. Besides
    the result, 9 bytes a voxel are used while it runs; of classes 4 for each, of up to 2^28 voxels at a time, and 9 for
    all; 24 more with `return_nearest`.

    Args:
        mask: (x,y,z), (B,x,y,z) or (B,1,x,y,z); bool, or numbers of which those that are not zero are foreground, or
            labels. At most 32767 voxels along an axis. A tensor, CuPy's, or a NumPy array, which is measured on the
            CPU. NaN is refused on a CPU; on a GPU, where a look at all values would wait for the device, it is
            foreground, and none of `classes`.
        spacing: Size of a voxel along each axis, in the unit that the distances shall have; one number for all axes.
        signed: Whether the inside has negative distances, rather than 0.
        surface: "centres" or "faces".
        missing: The distance where there is no voxel to measure to: all of a mask without foreground has `missing`,
            and, signed, all of one without background `-missing`.
        classes: The values of the classes; a number for 1 to it; or "all" for every value that is there but 0, sorted.
        out: Where to write the distances: float32 of the result's shape, contiguous, on the mask's device.
        return_nearest: Also return the nearest foreground voxel of each and its label: the Voronoi map of the labels.
            Of several that are equally near any. Unsigned transforms alone.

    Returns:
        float32 of the mask's shape, with `classes` (C,x,y,z) or (B,C,x,y,z); NumPy for NumPy, CuPy for CuPy. Correct to
        a few roundings; not differentiable, since a mask is not. With `return_nearest` also `NearestVoxels`.

    Raises:
        GridError: The shape or the spacing cannot be used.
        SDMError: `surface` is neither of the two, the mask holds no numbers or, on a CPU, NaN, classes that are none,
            or an `out` that does not fit.
    """
    if not isinstance(mask, Tensor):
        given, back = _tensor_of(mask)
        target = None if out is None else _tensor_of(out)[0]
        found = euclidean_distance_transform(
            given,
            spacing,
            signed=signed,
            surface=surface,
            missing=missing,
            classes=classes,
            out=target,
            return_nearest=return_nearest,
        )
        if isinstance(found, tuple):
            distance, nearest = found
            return back(distance) if out is None else out, NearestVoxels(*map(back, nearest))
        return back(found) if out is None else out
    size, shape = _check(mask, spacing, surface)
    if signed and return_nearest:
        raise SDMError("a signed transform has two nearest voxels everywhere: give return_nearest without signed")
    volumes = mask.detach().reshape(math.prod(mask.shape[:-3]), *shape)
    _refuse_nan(volumes)
    half = SURFACES[surface]
    if math.isnan(real(missing)):
        raise SDMError(f"missing is {missing!r}; give the distance where there is nothing to measure to")
    signed, missing = bool(signed), real(missing)
    values = None if classes is None else _values(classes, volumes)
    batch = mask.shape[: 0 if mask.ndim == 3 else 1]
    wanted = mask.shape if values is None else (*batch, len(values), *shape)
    if out is not None:
        _check_out(out, wanted, mask.device)
    if not mask.numel():
        distance = torch.empty(wanted, dtype=torch.float32, device=mask.device) if out is None else out
    elif values is None:
        inside = volumes if volumes.dtype == torch.bool else volumes != 0
        distance = torch.ops.sdm.euclidean_distance_transform(inside, size, half, signed, missing).reshape(wanted)
        distance = distance if out is None else out.copy_(distance)
    elif out is not None:
        fill_classes(volumes.contiguous(), values, size, half, signed, missing, out.view(-1, len(values), *shape))
        distance = out
    else:
        distance = torch.ops.sdm.euclidean_distance_transforms(
            volumes.contiguous(), values, size, half, signed, missing
        ).reshape(wanted)
    return (distance, _nearest(mask, volumes, values, distance, size, half)) if return_nearest else distance


def _nearest(
    mask: Tensor, volumes: Tensor, values: list[int] | None, distance: Tensor, size: list[float], half: float
) -> NearestVoxels:
    if values is None:
        index = torch.ops.sdm.nearest_voxels(volumes != 0, size, half)
        return NearestVoxels(index.reshape(*mask.shape, 3), labels_at(volumes, index).reshape(mask.shape))
    index = torch.stack([torch.ops.sdm.nearest_voxels(is_class(volumes, value), size, half) for value in values], 1)
    names = torch.tensor(values, device=mask.device).to(volumes.dtype)
    best = distance.reshape(-1, len(values), *volumes.shape[1:]).min(1)
    label = names[best.indices].masked_fill((index[..., 0] < 0).all(1), 0)
    return NearestVoxels(index.reshape(*distance.shape, 3), label.reshape(mask.shape))


def _check(mask: Tensor, spacing: float | Sequence[float], surface: str) -> tuple[list[float], tuple[int, ...]]:
    """Three voxel sizes and the volumes' shape (x,y,z), of arguments that can be used."""
    if not 3 <= mask.ndim <= 5 or (mask.ndim == 5 and mask.shape[1] != 1):
        raise GridError(
            f"a mask of shape {tuple(mask.shape)} has no distance transform: give (x,y,z), (B,x,y,z) or (B,1,x,y,z)"
        )
    size = spacing_of(spacing)
    if not isinstance(surface, str) or surface not in SURFACES:
        raise SDMError(f"the surface {surface!r} is unknown: choose 'centres' or 'faces'")
    shape = tuple(mask.shape[-3:])
    if max(shape) > LONGEST_LINE or shape[0] * shape[1] * max(shape[2], LANES) > MOST_VOXELS:
        raise GridError(
            f"a volume of shape {shape} is too large: at most {LONGEST_LINE} voxels along an axis and "
            f"{MOST_VOXELS} in all"
        )
    return size, shape


def _refuse_nan(volumes: Tensor) -> None:
    # Truth values and whole numbers have none, and a GPU would be waited for.
    if not volumes.dtype.is_floating_point or volumes.device.type != "cpu" or not volumes.numel():
        return
    if is_eager(volumes) and bool(volumes.amax().isnan()):
        raise SDMError(
            "the mask has voxels that are NaN, neither foreground nor background: give them a number first, 0 for "
            "background"
        )


def _check_out(out: Any, shape: Sequence[int], device: torch.device) -> None:
    if (
        not isinstance(out, Tensor)
        or out.dtype != torch.float32
        or tuple(out.shape) != tuple(shape)
        or out.device != device
        or not out.is_contiguous()
    ):
        raise SDMError(f"the result does not fit into out: give contiguous float32 of shape {tuple(shape)} on {device}")


def _values(classes: Classes, labels: Tensor) -> list[int]:
    """The values of classes, each once.

    Raises:
        SDMError: None, one twice, or what is no whole number.
    """
    if isinstance(classes, str):
        if classes != "all":
            raise SDMError(f"classes are {classes!r}: give their values, their number, or 'all'")
        found: list[Any] = [value for value in torch.unique(labels).tolist() if value != 0]
    elif isinstance(classes, int | np.integer):
        found = list(range(1, int(classes) + 1))
    else:
        found = np.asarray(classes.cpu() if isinstance(classes, Tensor) else classes).reshape(-1).tolist()
    if not found:
        raise SDMError("there are no classes to measure: give their values, or labels that are not all 0")
    if not all(real(value).is_integer() for value in found) or len(set(found)) < len(found):
        raise SDMError(f"classes are {found}: give whole numbers, each once")
    return [int(value) for value in found]


def _tensor_of(array: Any) -> tuple[Tensor, Callable[[Tensor], Any]]:
    """An array as a tensor that shares its memory, and the way back for results."""
    if type(array).__module__.split(".")[0] == "cupy":
        return torch.from_dlpack(array), import_module("cupy").from_dlpack
    for attribute, says in IMAGES.items():
        if hasattr(array, attribute):
            raise SDMError(f"an image is no mask, as it has axes of its own: give its voxels and their sizes, {says}")
    values = np.asarray(array)
    if values.dtype.kind not in "buif":
        raise SDMError(f"a mask holds numbers or truth values, not {values.dtype}: give a tensor or a NumPy array")
    odd = any(s < 0 or s % values.itemsize for s in values.strides)
    if odd or not values.dtype.isnative or not values.flags.writeable:
        values = np.array(values, dtype=values.dtype.newbyteorder("="), order="C")
    return torch.from_numpy(values.astype(np.float64) if values.dtype == np.longdouble else values), _as_numpy


def _as_numpy(tensor: Tensor) -> np.ndarray:
    return tensor.numpy()


def spacing_of(spacing: float | Sequence[float]) -> list[float]:
    """Three voxel sizes from one or three numbers.

    Raises:
        GridError: They are not three positive, finite numbers, or so different that their squares leave float32.
    """
    each: Any = [spacing] * 3 if not math.isnan(real(spacing)) else spacing
    sizes = [real(s) for s in each] if np.iterable(each) else []
    if len(sizes) != 3 or not all(0 < s < math.inf for s in sizes):
        raise GridError(f"the spacing {spacing!r} must be one or three positive numbers")
    if max(sizes) > 1e9 * min(sizes):
        raise GridError(f"the spacing {spacing} differs too much between the axes: by at most a factor of 1e9")
    return sizes
