"""The built-in mesh: a tapered spiral tube in the manner of a cochlea, made from a formula."""

from __future__ import annotations

import numpy as np
import torch

from sdm.core.mesh import TriangleMesh

TURNS = 2.6
BASAL_RADIUS_MM = 4.3  # of the spiral, at its wide end
APICAL_RADIUS_MM = 0.75
HEIGHT_MM = 3.4  # from the first to the last point of the centre line
BASAL_TUBE_MM = 1.0  # half width of the tube
APICAL_TUBE_MM = 0.42
FLATNESS = 0.8  # width of the cross-section against its height
CAP = 0.9  # length of a rounded end against the tube's half width there


def demo_mesh(rings: int = 201, segments: int = 48, cap_rings: int = 5) -> TriangleMesh:
    """A spiral tube with rounded ends, closed and facing outward, in millimetres; always the same.

    Args:
        rings: Cross-sections along the tube.
        segments: Vertices of a cross-section.
        cap_rings: Cross-sections of each rounded end, without its pole.

    Returns:
        A mesh of `2 * segments * (rings + 2 * cap_rings)` triangles: 20,256 by default.
    """
    position = np.linspace(0.0, 1.0, rings)
    centre, frame = _centre_line(position)
    half_width = BASAL_TUBE_MM * (APICAL_TUBE_MM / BASAL_TUBE_MM) ** position

    # A rounded end goes on straight along the tangent while its radius falls as a quarter ellipse.
    angle = np.arange(1, cap_rings + 2) / (cap_rings + 1) * (np.pi / 2)
    along, shrink = CAP * np.sin(angle), np.cos(angle)
    base_centre = centre[0] - half_width[0] * along[:, None] * frame[0, 0]
    apex_centre = centre[-1] + half_width[-1] * along[:, None] * frame[-1, 0]
    all_centres = np.concatenate([base_centre[-2::-1], centre, apex_centre[:-1]])
    all_widths = np.concatenate([half_width[0] * shrink[-2::-1], half_width, half_width[-1] * shrink[:-1]])
    all_frames = np.concatenate([frame[:1].repeat(cap_rings, 0), frame, frame[-1:].repeat(cap_rings, 0)])

    turn = np.arange(segments) / segments * (2 * np.pi)
    across = FLATNESS * np.cos(turn)[:, None] * all_frames[:, None, 1] + np.sin(turn)[:, None] * all_frames[:, None, 2]
    wall = (all_centres[:, None] + all_widths[:, None, None] * across).reshape(-1, 3)
    vertices = np.concatenate([wall, base_centre[-1:], apex_centre[-1:]])
    faces = _tube_faces(len(all_centres), segments)
    return TriangleMesh(torch.from_numpy(vertices.astype(np.float32)), torch.from_numpy(faces), "demo cochlea")


def _centre_line(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (n,3) of a logarithmic spiral that rises, and the frames (n,3,3): tangent, sideways, up."""
    angle = 2 * np.pi * TURNS * position
    decay = np.log(APICAL_RADIUS_MM / BASAL_RADIUS_MM)
    radius = BASAL_RADIUS_MM * np.exp(decay * position)
    cos, sin = np.cos(angle), np.sin(angle)
    centre = np.stack([radius * cos, radius * sin, HEIGHT_MM * position], -1)
    speed = 2 * np.pi * TURNS
    tangent = np.stack(
        [radius * (decay * cos - speed * sin), radius * (decay * sin + speed * cos), np.full_like(angle, HEIGHT_MM)], -1
    )
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    # The tube never climbs steeply, so the vertical tells every cross-section the same way up.
    up = np.array([0.0, 0.0, 1.0]) - tangent * tangent[:, 2:]
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    return centre, np.stack([tangent, np.cross(up, tangent), up], 1)


def _tube_faces(rings: int, segments: int) -> np.ndarray:
    """Faces of `rings` cross-sections in a row, then the first pole, then the last one."""
    ring, step = np.meshgrid(np.arange(rings - 1), np.arange(segments), indexing="ij")
    here = ring * segments + step
    beside = ring * segments + (step + 1) % segments
    there, across = here + segments, beside + segments
    wall = np.concatenate(
        [np.stack([here, beside, across], -1).reshape(-1, 3), np.stack([here, across, there], -1).reshape(-1, 3)]
    )
    step = np.arange(segments)
    beside = (step + 1) % segments
    first_pole, last_ring = rings * segments, (rings - 1) * segments
    first = np.stack([np.full(segments, first_pole), beside, step], -1)
    last = np.stack([np.full(segments, first_pole + 1), last_ring + step, last_ring + beside], -1)
    return np.concatenate([first, wall, last]).astype(np.int32)
