"""Damaged mesh files: every face that the file declares, or one sentence."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from sdm.bench.common.mesh_formulas import sphere, torus
from sdm.bench.fuzz.damage import drawn
from sdm.bench.fuzz.trial import Finding, Outcome, one_sentence
from sdm.core.mesh import TriangleMesh
from sdm.io import load_mesh, save_mesh

FORMATS = ("ply", "ply-text", "off", "obj", "stl", "stl-text", "glb", "gltf", "gii", "pial", "vtk", "vtp")
# Those that trimesh does not write.
OWN = ("gii", "pial", "vtk", "vtp")
# Damage after which a mesh with fewer faces than before is a finding: the file still declares them all.
SHORTENING = ("cut",)


def encoded(vertices: np.ndarray, faces: np.ndarray, kind: str) -> tuple[str, bytes]:
    """The ending and the bytes of a mesh in a format."""
    if kind in OWN:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"mesh.{kind}"
            save_mesh(TriangleMesh(vertices, faces), path)
            return kind, path.read_bytes()
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    ending, options = {"ply-text": ("ply", {"encoding": "ascii"}), "stl-text": ("stl_ascii", {})}.get(kind, (kind, {}))
    data: Any = mesh.export(file_type=ending, **options)
    if isinstance(data, dict):
        # The buffers of a glTF lie in other files, so the header alone is damaged.
        data = data["model.gltf"]
    return ending.removesuffix("_ascii"), data.encode() if isinstance(data, str) else bytes(data)


def trial(rng: np.random.Generator, folder: Path) -> Outcome:
    """One mesh in one format with one kind of damage."""
    arrays = [lambda: sphere(6), lambda: torus(64), lambda: sphere(3)][rng.integers(3)]
    vertices, faces = arrays()
    kind = FORMATS[rng.integers(len(FORMATS))]
    ending, data = encoded(vertices, faces, kind)
    name, damage = drawn(rng)
    path = folder / f"mesh.{ending}"
    damaged = damage(data, rng)
    path.write_bytes(damaged)
    # An OBJ declares no number of faces: each line of one is a promise.
    promised = sum(line.startswith(b"f") for line in damaged.splitlines()) if kind == "obj" else len(faces)
    label = f"{kind} {name}"
    with one_sentence(label) as outcome:
        mesh = load_mesh(path)
        if not np.isfinite(mesh.vertices.numpy()).all():
            raise Finding(f"{label}: vertices that are not finite")
        if len(mesh.faces) and int(mesh.faces.max()) >= len(mesh.vertices):
            raise Finding(f"{label}: a face of a vertex that is not there")
        if name in SHORTENING and kind != "gltf" and len(mesh.faces) < promised:
            raise Finding(f"{label}: {len(mesh.faces)} of {promised} faces, without a word")
    return outcome[0] if outcome else Outcome(label, refused=False)
