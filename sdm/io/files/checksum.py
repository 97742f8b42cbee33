"""Checksum of a map's values, and digest of a mesh. It imports little: see `worker_processes`."""

from __future__ import annotations

import hashlib

import numpy as np
from isal import isal_zlib

# Hexadecimal digits.
DIGEST = 32


def checksum_of(values: np.ndarray, begin: int) -> str:
    """Eight hexadecimal digits: the CRC-32 of float32 values, after what has the checksum `begin`."""
    # That of zlib, in a fifth of the time.
    return f"{isal_zlib.crc32(np.ascontiguousarray(values, '<f4').data, begin):08x}"


def mesh_digest(vertices: np.ndarray, faces: np.ndarray, how: str) -> str:
    """Digest of vertices (V,3) float32, faces (F,3) int32 and some words: see `sdm.io.maps.record.digest_of`."""
    digest = hashlib.sha256(f"{vertices.shape} {faces.shape}{how}".encode())
    digest.update(np.ascontiguousarray(vertices, "<f4").data)
    digest.update(np.ascontiguousarray(faces, "<i4").data)
    return digest.hexdigest()[:DIGEST]
