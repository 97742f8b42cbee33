"""`.nii` and `.nii.gz` by nibabel: the affine in sform and qform, the exact geometry in a header extension."""

from __future__ import annotations

import json
import logging
import math
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import nibabel as nib
import numpy as np
import torch
from nibabel.fileholders import FileHolder
from nibabel.imageglobals import logger as nibabel_logger
from nibabel.nifti2 import Nifti2Header
from nibabel.openers import ImageOpener

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError, SDMWarning
from sdm.io.files.nifti_stream import pieces, write_and_count, write_file
from sdm.io.maps.check_dtype import plain_numbers
from sdm.io.maps.gzip_check import held
from sdm.io.maps.nifti_header import nifti_header
from sdm.io.maps.record import (
    CHECKSUM,
    KEY,
    OPEN,
    from_record,
    record,
    sign_arguments,
    signs_of,
    to_line,
    verify,
    with_checksum,
    with_open_checksum,
)

# Of a record of ours among the comments.
BEGIN = f'{{"{KEY}":'.encode()
SCANNER = 1
# Units of length that files of maps do not name.
OTHER_UNITS = {"meter": "metres", "micron": "micrometres"}
# The last entry of a record whose values nobody has looked at.
OPEN_ENTRY = to_line({CHECKSUM: OPEN}).encode()[1:-1]


class _Remarks(threading.local):
    """Log of nibabel about a file that this thread reads, which it would print as it is."""

    said: list[str] | None = None

    @contextmanager
    def heard(self) -> Iterator[list[str]]:
        """Remarks of the block, which are not printed."""
        before, self.said = self.said, []
        try:
            yield self.said
        finally:
            self.said = before

    def filter(self, record: logging.LogRecord) -> bool:
        """See `logging.Filter`."""
        if self.said is None:
            return True
        self.said.append(record.getMessage())
        return False


_remarks = _Remarks()
nibabel_logger.addFilter(_remarks.filter)


def write(field: SDM, path: Path, made_from: str | None = None) -> None:
    """Write `.nii`."""
    with path.open("wb") as file:
        for piece in pieces(*planned(field, made_from)):
            file.write(piece.data)


def write_compressed(field: SDM, path: Path, made_from: str | None = None, *, space: int = SCANNER) -> None:
    """Write `.nii.gz`. The same map gives the same bytes: no name, no time.

    `space` is NIfTI's number of the space that the affine leads to: 1, the scanner's, or 0, unknown, and so on.
    """
    write_file(path, *planned(field, made_from, space=space))


def planned(field: SDM, made_from: str | None = None, *, space: int = SCANNER) -> tuple[bytes, np.ndarray]:
    """Arguments of `write_file` after the path."""
    values = field.numpy().astype(np.float32, copy=False)
    kept = with_checksum(record(field.grid, field.ambiguous_voxels, made_from, signs_of(field)), values)
    return _head(field, kept, space), values


def planned_unseen(field: SDM, made_from: str | None = None) -> tuple[Callable[..., int], tuple[Any, ...]]:
    """Function that writes `.nii.gz` without torch and counts voxels inside, and its arguments after the path.

    Nobody has looked at the values until then.
    """
    kept, begin = with_open_checksum(record(field.grid, field.ambiguous_voxels, made_from, signs_of(field)))
    head = _head(field, kept, SCANNER)
    values, at = field.numpy().astype(np.float32, copy=False), head.rindex(OPEN_ENTRY) + OPEN_ENTRY.index(b"0")
    return write_and_count, (head, values, at, begin)


def _head(field: SDM, kept: dict[str, Any], space: int) -> bytes:
    return nifti_header(field.grid.affine, field.grid.shape, to_line({KEY: kept}).encode(), space)


def read(path: Path) -> SDM:
    """Read a map, or any image of three dimensions: scaling is applied, values become float32."""
    with held(path) as holder:
        image = opened(path, holder, with_lengths=True)
        grid, count, kept = _geometry(image, path)
        values = plain_numbers(np.asanyarray(image.dataobj).reshape(grid.shape), path)
        verify(kept, values, str(path))
        return SDM(torch.from_numpy(values), grid, count, **sign_arguments(kept))


def read_grid(path: Path) -> Grid:
    """Read the geometry alone."""
    return _geometry(opened(path, with_lengths=True), path)[0]


def is_placed(path: Path) -> bool:
    """True if the image says how it lies in space. Where it does not, nibabel and ITK place it differently."""
    header = opened(path).header
    return int(header["qform_code"]) > 0 or int(header["sform_code"]) > 0


def read_record(path: Path) -> Any:
    """Read what is kept beside the values; None where that is nothing."""
    kept = (_said(extension.get_content(), path) for extension in opened(path).header.extensions)
    return next((found for found in kept if found is not None), None)


def opened(path: Path, holder: FileHolder | None = None, *, with_lengths: bool = False) -> Any:
    """An image of NIfTI-1 or NIfTI-2, whose values are not yet read. `with_lengths` warns of those that are guessed.

    Raises:
        FormatError: It is neither.
    """
    # By content, since nibabel's own search for the file is particular about capitals.
    with ImageOpener(str(path)) as file:
        head = file.read(Nifti2Header.template_dtype.itemsize)
    for kind in (nib.Nifti1Image, nib.Nifti2Image):
        if kind.header_class.may_contain_header(head):
            with _remarks.heard() as remarks:
                image = kind.from_file_map({"image": holder or FileHolder(str(path))})
            # Other remarks are for those who write files. Of a header with an sform voxel sizes say nothing.
            guessed = any("0 dims" in remark for remark in remarks)
            if with_lengths and guessed and int(image.header["sform_code"]) == 0:
                header = kind.header_class(head[: kind.header_class.sizeof_hdr], check=False)
                sizes = ", ".join(f"{size:g}" for size in header["pixdim"][1:4])
                warnings.warn(
                    f"{path} has voxel sizes of ({sizes}): a size of 0 is read as 1, so that lengths may be wrong",
                    SDMWarning,
                    stacklevel=2,
                )
            if with_lengths and (unit := OTHER_UNITS.get(str(image.header.get_xyzt_units()[0]))) is not None:
                warnings.warn(
                    f"{path} counts in {unit}, and so do distances on its grid; files of maps say millimetres all the "
                    f"same, so that other tools take one for the other: give an image in millimetres",
                    SDMWarning,
                    stacklevel=2,
                )
            return image
    raise FormatError(f"{path} is not a NIfTI image")


def _geometry(image: Any, path: Path) -> tuple[Grid, int | None, Any]:
    """Grid, count of ambiguous voxels, and the record that both are from; None where the image's header tells."""
    shape = tuple(image.shape)
    if len(shape) < 3 or any(n != 1 for n in shape[3:]):
        several = "; take one of its volumes first, as image.slicer[..., 0] of nibabel does" if len(shape) > 3 else ""
        raise FormatError(f"{path} has the shape {shape}; an image of three dimensions is needed{several}")
    for extension in image.header.extensions:
        kept = _said(extension.get_content(), path)
        exact = None if kept is None else from_record(kept, str(path))
        if exact is not None and exact[0].shape != shape[:3]:
            _check_length(image, path)
        elif exact is not None and _close(exact[0].affine, image.affine):
            return *exact, kept
    return Grid.from_affine(image.affine, shape[:3]), None, None


def _check_length(image: Any, path: Path) -> None:
    """Of a map of ours with another shape, as a crop has, see that no damage made that shape."""
    needed = int(image.dataobj.offset) + image.dataobj.dtype.itemsize * math.prod(image.shape)
    if not path.name.lower().endswith(".gz") and path.stat().st_size != needed:
        raise FormatError(f"{path} is damaged: {needed:,} bytes are needed for its shape, and it has others")


def _said(content: Any, path: Path) -> Any:
    try:
        found = json.loads(content)
    except (TypeError, ValueError):
        if isinstance(content, bytes) and content.lstrip().startswith(BEGIN):
            # Without it, values would be read that nothing vouches for.
            raise FormatError(f"{path} is damaged: its sdm record is no JSON") from None
        return None
    # Other software keeps its comments here too.
    return found.get(KEY) if isinstance(found, dict) else None


def _close(exact: np.ndarray, rounded: np.ndarray) -> bool:
    """True if an affine is another's float32 rounding: then nobody has moved the image since it was written."""
    return bool(np.allclose(exact, rounded, rtol=2e-7, atol=1e-6 * np.abs(exact[:3, :3]).max()))
