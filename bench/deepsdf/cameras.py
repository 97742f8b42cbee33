"""Points and normals that virtual cameras around a shape see: DeepSDF's dense oriented points, without a display."""
# Warp's own compiler checks the types inside kernels, by rules that are not Python's.
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportIndexIssue=false
# pyright: reportOperatorIssue=false

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import warp as wp
from torch import Tensor

from sdm.bench.peers.warp import on_torch_stream
from sdm.core.mesh import TriangleMesh
from sdm.kernels.launch import launch

# Views that are traced at a time: rays of all hundred at once take 600 MB.
AT_ONCE = 10
# A camera's distance from the middle in unit-sphere radii, and the cosine below which a face counts as seen edge-on.
AWAY, EDGE_ON = 1.1, 0.001


@dataclass(frozen=True)
class Cameras:
    """Orthographic cameras that look at the middle of the unit sphere; 100 images of 400^2 pixels as published."""

    views: int = 100
    pixels: int = 400

    def directions(self) -> Tensor:
        """Unit vectors (views,3) from the middle to the cameras: evenly on a golden spiral."""
        number = torch.arange(self.views, dtype=torch.float64)
        y = (2 * number + 1) / self.views - 1
        ring = (1 - y**2).sqrt()
        angle = (number + 1) * math.pi * (3 - math.sqrt(5))
        return torch.stack([ring * angle.cos(), y, ring * angle.sin()], 1).float()


@wp.kernel(enable_backward=False)
def _trace(
    begin: int,
    mesh: wp.uint64,
    directions: wp.array[wp.vec3],
    pixels: int,
    points: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
):
    """One ray of one pixel; a normal of zero where it meets nothing."""
    thread = begin + wp.tid()
    view = thread / (pixels * pixels)
    row = (thread / pixels) % pixels
    column = thread % pixels
    to_camera = directions[view]
    right = wp.normalize(wp.cross(wp.vec3(0.0, 1.0, 0.0), to_camera))
    up = wp.cross(to_camera, right)
    size = 2.0 / float(pixels)
    start = AWAY * to_camera + ((float(column) + 0.5) * size - 1.0) * right + ((float(row) + 0.5) * size - 1.0) * up
    normal = wp.vec3()
    hit = wp.mesh_query_ray(mesh, start, -to_camera, 2.0 * AWAY)
    if hit.result:
        facing = wp.dot(hit.normal, to_camera)
        if wp.abs(facing) >= EDGE_ON:
            points[thread] = wp.mesh_eval_position(mesh, hit.face, hit.u, hit.v)
            normal = wp.where(facing < 0.0, -hit.normal, hit.normal)
    normals[thread] = normal


def seen_points(mesh: TriangleMesh, cameras: Cameras) -> tuple[Tensor, Tensor]:
    """Points (N,3) of a normalised mesh that some camera sees, one a pixel, and their normals (N,3) towards it.

    J. Park et al., CVPR 2019, and their published preprocessing: images of positions and of faces' normals, a normal
    that looks away from its camera turned around, faces seen edge-on left out.
    """
    device = str(mesh.device)
    found, towards = [], []
    with on_torch_stream(device):
        vertices = wp.from_torch(mesh.vertices.detach().contiguous(), dtype=wp.vec3)
        traced = wp.Mesh(vertices, wp.from_torch(mesh.faces.reshape(-1).contiguous()))
        for some in cameras.directions().to(mesh.device).split(AT_ONCE):
            count = len(some) * cameras.pixels**2
            points, normals = (torch.zeros(count, 3, device=mesh.device) for _ in range(2))
            arrays = [wp.from_torch(t.contiguous(), dtype=wp.vec3) for t in (some, points, normals)]
            launch(_trace, count, [traced.id, arrays[0], cameras.pixels, *arrays[1:]], device)
            seen = (normals != 0).any(1)
            found.append(points[seen])
            towards.append(normals[seen])
    return torch.cat(found), torch.cat(towards)
