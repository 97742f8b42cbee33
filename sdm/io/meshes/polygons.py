"""Concave polygons of OBJ, OFF and PLY files, which trimesh would cut into fans that reach out of them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from sdm.io.meshes.ear_clipping import cut, find_wrong_fans
from sdm.io.meshes.obj_text import plain_obj, without_textures

# With the end of the line before: a search for plain text is much faster than one for the begin of a line.
OBJ_VERTEX = re.compile(rb"\nv [ \t]*(\S+)[ \t]+(\S+)[ \t]+(\S+)")
OBJ_POLYGON = re.compile(rb"\nf((?:[ \t]+[^\s#]+){4,})[ \t]*(?=\n|\Z)")
# From so many corners on, trimesh takes a face for one with fewer whose corners have texture and normal, if all of a
# material have as many numbers: six corners of two numbers for four of three.
OBJ_MISTAKEN = 6
OFF_COMMENT = re.compile(rb"#[^\n]*")
OFF_TRIANGLE = (b"3 ", b"3\t")
PLY_NAMES = ("vertex_index", "vertex_indices")


def cut_text(path: Path) -> bytes | None:
    """The text of an OBJ or OFF file with triangles for the polygons that its parser would not cut rightly.

    Of OBJ files also what else it would not read rightly. None if there is nothing of the kind, so that files of
    triangles and of convex polygons are parsed as they are; and for a file with anything odd, which is for its parser
    to refuse.
    """
    rewrite = {".obj": _obj, ".off": _off}.get(path.suffix.lower())
    if rewrite is None:
        return None
    data = path.read_bytes()
    plain = plain_obj(data) if rewrite is _obj else data
    try:
        found = rewrite(plain)
    except (ValueError, IndexError):
        found = None
    return plain if found is None and plain is not data else found


def _obj(data: bytes) -> bytes | None:
    if b"\r" in data or b"\\" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\\\n", b"")
    data = b"\n" + data
    lines = list(OBJ_POLYGON.finditer(data))
    if not lines:
        return None
    bare = b"/" in data and max(len(line[1].split()) for line in lines) >= OBJ_MISTAKEN
    if bare:
        data = without_textures(data)
        lines = list(OBJ_POLYGON.finditer(data))
    vertices = np.array(OBJ_VERTEX.findall(data)).astype(np.float64)
    corners = [line[1].split() for line in lines]
    # Counted from 1.
    polygons = [np.array([int(corner.split(b"/", 1)[0]) for corner in polygon]) - 1 for polygon in corners]
    parts, done = [], 0
    for number in find_wrong_fans(vertices, polygons):
        line, names = lines[number], corners[number]
        triangles = cut(vertices[polygons[number]])
        parts += [data[done : line.start()], b"".join(b"\nf " + b" ".join(names[n] for n in t) for t in triangles)]
        done = line.end()
    return b"".join([*parts, data[done:]]) if parts or bare else None


def _off(data: bytes) -> bytes | None:
    data = OFF_COMMENT.sub(b"", data) if b"#" in data else data
    header, _, rest = data.partition(b"OFF")
    lines = [line for line in rest.splitlines() if line.strip()]
    vertex_count, face_count = (int(number) for number in lines[0].split()[:2])
    end = 1 + vertex_count + face_count
    faces_at = lines[1 + vertex_count : end]
    if all(line.lstrip()[:2] in OFF_TRIANGLE for line in faces_at):
        return None
    rows = [line.split() for line in faces_at]
    vertices = np.array([line.split()[:3] for line in lines[1 : 1 + vertex_count]]).astype(np.float64)
    polygons = [np.array(row[1 : 1 + int(row[0])]).astype(np.int64) for row in rows]
    if min(polygon.min() for polygon in polygons) < 0:
        return None
    # trimesh takes no more than four corners here, whatever their shape.
    to_cut = {*find_wrong_fans(vertices, polygons), *(n for n, p in enumerate(polygons) if len(p) > 4)}
    if not to_cut:
        return None
    faces: list[list[int]] = []
    for number, polygon in enumerate(polygons):
        triangles = cut(vertices[polygon]) if number in to_cut else [range(len(polygon))]
        faces += [[int(polygon[corner]) for corner in triangle] for triangle in triangles]
    text = [header + b"OFF", b"%d %d 0" % (vertex_count, len(faces)), *lines[1 : 1 + vertex_count]]
    text += [b" ".join(b"%d" % number for number in (len(face), *face)) for face in faces]
    return b"\n".join([*text, b""])


def cut_ply(part: Any) -> tuple[np.ndarray, np.ndarray] | None:
    """Vertices (V,3) and faces (F,3) of a part that trimesh read from PLY; None if its own are right.

    Its parser keeps the polygons as they are in the file, in `metadata`.
    """
    raw = part.metadata.get("_ply_raw")
    if raw is None:
        return None
    polygons = _ply_polygons(raw["face"]["data"])
    if polygons is None:
        return None
    vertices = np.column_stack([raw["vertex"]["data"][axis] for axis in "xyz"]).astype(np.float64)
    if any(len(polygon) and (polygon.min() < 0 or polygon.max() >= len(vertices)) for polygon in polygons):
        return None
    wrong = find_wrong_fans(vertices, polygons)
    if not wrong:
        return None
    faces = [polygon[cut(vertices[polygon])] for polygon in polygons if len(polygon) >= 3]
    return vertices, np.concatenate(faces).astype(np.int64)


def _ply_polygons(data: Any) -> Any:
    """Rows of corners, of one length or of several; None if all are triangles."""
    names = list(data) if isinstance(data, dict) else list(data.dtype.names)
    name = next((name for name in PLY_NAMES if name in names), names[0])
    rows = data[name] if isinstance(data, dict) else data[name]["f1"]
    return None if rows.ndim == 2 and rows.shape[1] == 3 else [np.asarray(row, np.int64).ravel() for row in rows]
