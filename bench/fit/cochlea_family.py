"""Distance of the cochlea family from the real mean human scala tympani, and a check that every shape of it is sound.

    python -m sdm.bench.fit.cochlea_family [--data FOLDER] [--samples 1000] [--out bench/results/cochlea_fit.json]

Needs libigl (distances; exact self-intersections by CGAL) and, for a second opinion, pymeshlab. Takes about two
minutes on one core. The family's fixed constants were tuned once to this same mean shape, so the distance says how
well four parameters and a rigid pose describe it, not how well they describe other people's.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import itertools
import json
import time
from pathlib import Path

import igl
import igl.copyleft.cgal as cgal
import numpy as np
import torch
import trimesh
from scipy.spatial.transform import Rotation

from sdm.bench.common.checkout import data_folder, results_folder
from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.inspect.edges import edges_of
from sdm.shapes import Cochlea

# Where the fit starts: a plain cochlea, turned and moved roughly onto the real one.
START = (3.5, 0.3, 0.14, 0.0)
TURN = -1.1
SAMPLES = 50_000
STEP = 1e-3
ITERATIONS = 40
# Share of each curvature that is added to it: shorter steps, none of them wild.
DAMPING = 0.02


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=data_folder())
    parser.add_argument("--samples", type=int, default=1000, help="random shapes to check besides the 16 corners")
    parser.add_argument("--out", type=Path, default=results_folder() / "cochlea_fit.json")
    options = parser.parse_args()
    family = Cochlea()
    result = {
        "family": {"triangles": len(family.faces), "fingerprint": family.fingerprint},
        "fit": fit(family, options.data),
        "soundness": soundness(family, options.samples),
        "versions": {name: importlib.metadata.version(name) for name in ("libigl", "torch", "warp-lang", "numpy")},
        "machine": describe("cpu"),
    }
    write(options.out, result)
    print(json.dumps(result, indent=1))


def fit(family: Cochlea, data: Path) -> dict:
    """Four parameters and a rigid pose for the real scala tympani, by damped Gauss-Newton on distances both ways."""
    target = igl.read_triangle_mesh(str(data / "scala_tympani" / "scala_tympani_mean.ply"))
    vertices, faces = np.asarray(target[0], np.float64), np.asarray(target[1], np.int64)
    real = trimesh.Trimesh(vertices, faces, process=False)
    probes = spread(real, 4_000, seed=0)[0]
    outward = np.asarray(real.face_normals)
    own_faces = family.faces.numpy().astype(np.int64)
    # Rows of barycentric coordinates pick the same points of every shape, evenly spread on a plain one.
    plain = trimesh.Trimesh(family.mesh(START).vertices.numpy(), own_faces, process=False)
    points, where = spread(plain, 4_000, seed=1)
    weights = trimesh.triangles.points_to_barycentric(plain.triangles[where], points)

    def place(x: np.ndarray) -> np.ndarray:
        own = family.vertices(torch.from_numpy(x[None, :4]))[0].double().numpy()
        return own @ Rotation.from_rotvec(x[4:7]).as_matrix().T + x[7:]

    def residuals(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances along the normal, both ways, and their derivatives while the closest points stay what they are."""
        own = place(x)
        # Steps far above the rounding of float32 vertices.
        moves = np.stack([(place(x + step) - own) / STEP for step in STEP * np.eye(len(x))], -1)
        at = (own[own_faces[where]] * weights[..., None]).sum(1)
        _, hit, there = nearest(at, vertices, faces)
        first = ((at - there) * outward[hit]).sum(1)
        first_by = np.einsum("nk,nkcp,nc->np", weights, moves[own_faces[where]], outward[hit])
        _, hit, back = nearest(probes, own, own_faces)
        corners = own[own_faces[hit]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        second = ((back - probes) * normal).sum(1)
        share = trimesh.triangles.points_to_barycentric(corners, back)
        second_by = np.einsum("nk,nkcp,nc->np", share, moves[own_faces[hit]], normal)
        return np.concatenate([first, second]), np.concatenate([first_by, second_by])

    low, high = (np.array([getattr(p, end) for p in family.parameters]) for end in ("low", "high"))
    begin = time.perf_counter()
    x = np.array([*START, 0, 0, TURN, *(vertices.mean(0) - [0, 0, 1.0])])
    for _ in range(ITERATIONS):
        values, by = residuals(x)
        normal_matrix = by.T @ by
        damping = DAMPING * np.diag(np.diag(normal_matrix))
        x = x - np.linalg.solve(normal_matrix + damping, by.T @ values)
        x[:4] = x[:4].clip(low, high)
    seconds = time.perf_counter() - begin

    own = trimesh.Trimesh(place(x), own_faces, process=False)
    at = spread(own, SAMPLES, seed=2)[0]
    there = nearest(at, vertices, faces)[0]
    at = spread(real, SAMPLES, seed=3)[0]
    back = nearest(at, place(x), own_faces)[0]
    both = np.concatenate([there, back])
    return {
        "target": "mean of 15 human scalae tympani, Froehlich 2024",
        "theta": {p.name: round(float(v), 4) for p, v in zip(family.parameters, x[:4], strict=True)},
        "rotation_vector_rad": x[4:7].round(4).tolist(),
        "translation_mm": x[7:].round(4).tolist(),
        "mean_symmetric_surface_distance_mm": round(float((there.mean() + back.mean()) / 2), 4),
        "family_to_real_mean_mm": round(float(there.mean()), 4),
        "real_to_family_mean_mm": round(float(back.mean()), 4),
        "hausdorff_95_mm": round(float(np.percentile(both, 95)), 4),
        "hausdorff_mm": round(float(both.max()), 4),
        "volume_mm3": round(float(own.volume), 3),
        "real_volume_mm3": round(float(real.volume), 3),
        "points_each_way": SAMPLES,
        "iterations": ITERATIONS,
        "seconds": round(seconds, 1),
    }


def nearest(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance, face and position of the closest point of a mesh to each of `points` (N,3)."""
    square, face, position = (np.asarray(part) for part in igl.point_mesh_squared_distance(points, vertices, faces)[:3])
    return np.sqrt(square), face, position


def spread(mesh: trimesh.Trimesh, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Random points (count,3) on the surface, evenly by area, and their faces (count,)."""
    found = trimesh.sample.sample_surface(mesh, count, seed=seed)
    return np.asarray(found[0]), np.asarray(found[1])


def soundness(family: Cochlea, samples: int) -> dict:
    """The 16 corners of the box and random shapes: closed, outward, no self-intersection, healthy triangles."""
    corners = family.from_unit(torch.tensor(list(itertools.product((0.0, 1.0), repeat=4))))
    theta = torch.cat([corners, family.sample(samples, seed=2020, device="cpu")])
    faces = family.faces.numpy().astype(np.int64)
    edges = edges_of(faces, int(faces.max()) + 1)
    closed = bool((edges.uses == 2).all()) and not edges.chain.any()
    report = {"shapes": len(theta), "closed_and_oriented": closed, "seed": 2020}
    bad, inside_out, second, checked = [], 0, 0, 0
    least, aspect, small = [], [], []
    for row in theta:
        vertices = family.vertices(row[None])[0].double().numpy()
        if np.asarray(cgal.remesh_self_intersections(vertices, faces, detect_only=True)[2]).size:
            bad.append(row.tolist())
        selected = meshlab(vertices, faces)
        if selected is not None:
            checked += 1
            second += selected > 0
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        inside_out += mesh.volume <= 0
        angles = np.degrees(mesh.face_angles)
        sides = np.linalg.norm(np.diff(mesh.triangles[:, [0, 1, 2, 0]], axis=1), axis=2)
        least.append(angles.min())
        small.append((angles.min(1) < 10).mean())
        # Longest edge over shortest height, 1.15 for an equilateral triangle.
        aspect.append((sides.max(1) ** 2 / (2 * mesh.area_faces)).max())
    return report | {
        "self_intersecting_by_cgal": len(bad),
        "self_intersecting_theta": bad[:10],
        "self_intersecting_by_meshlab": int(second),
        "checked_by_meshlab": checked,
        "inside_out": int(inside_out),
        "least_angle_deg": {"worst": round(min(least), 2), "median_shape": round(float(np.median(least)), 2)},
        "share_of_triangles_below_10_deg": {"worst": round(max(small), 4), "mean": round(float(np.mean(small)), 4)},
        "largest_aspect": {"worst": round(max(aspect), 1), "median_shape": round(float(np.median(aspect)), 1)},
    }


def meshlab(vertices: np.ndarray, faces: np.ndarray) -> int | None:
    """Faces that intersect another by MeshLab, in float32; None where it is not installed."""
    try:
        pymeshlab = importlib.import_module("pymeshlab")
    except ImportError:
        return None
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertices, faces))
    meshes.compute_selection_by_self_intersections_per_face()
    return meshes.current_mesh().selected_face_number()


if __name__ == "__main__":
    main()
