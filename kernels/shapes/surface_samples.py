"""DeepSDF's samples of many shapes in one scene: near the surface at two scales, and anywhere in a box.

Each is a pure function of the seed and its own number: eight numbers in [0,1) from Philox. A sample near the surface
takes one for its place along the faces' summed areas, two for its place in the face, and four for a normal offset (Box
and Muller: two pairs of numbers make four normal ones, of which three are used). One anywhere takes three.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.launch import launch
from sdm.kernels.shapes.counter_random import counter_of, philox, unit_float

wp.set_module_options({"enable_backward": False})


@wp.struct
class Scene:
    """Shapes with room between them; face f of the scene has the corners 3f to 3f + 2."""

    places: wp.array(dtype=wp.vec3)  # (shapes) the middle of each
    corners: wp.array(dtype=wp.vec3)  # (3 * faces)
    areas: wp.array(dtype=wp.float64)  # (faces) of all faces up to this one
    area_before: wp.array(dtype=wp.float64)  # (shapes) of all faces of the shapes before
    area_size: wp.array(dtype=wp.float64)  # (shapes)
    last_face: wp.array(dtype=wp.int64)  # (shapes)


@wp.struct
class Law:
    """Distribution of the samples; see `sdm.deepsdf.samples.SampleDistribution`."""

    near: wp.int32  # of a shape's samples, the first
    wide: float  # deviation of samples 0, 2, 4 ...
    tight: float  # and of the others
    box: float  # half the edge of the box
    reach: float  # how far from their shape's middle samples may be, along each axis


@wp.func
def face_at(scene: Scene, shape: int, place: wp.float64):
    """The first face up to which there is more area than `place`."""
    low = int(0)
    high = int(scene.last_face[shape])
    while low < high:
        middle = (low + high) / 2
        if scene.areas[middle] > place:
            high = middle
        else:
            low = middle + 1
    return low


@wp.func
def normal_pair(length: float, turn: float):
    """Two independent normal numbers from two in [0,1)."""
    # 1 - length is never 0.
    r = wp.sqrt(-2.0 * wp.log(1.0 - length))
    return wp.vec2(r * wp.cos(2.0 * wp.PI * turn), r * wp.sin(2.0 * wp.PI * turn))


@wp.kernel
def _draw(
    begin: int,
    scene: Scene,
    law: Law,
    low: wp.uint32,
    high: wp.uint32,
    first: wp.int64,
    shapes: wp.array(dtype=wp.int64),
    count: int,
    in_scene: wp.array(dtype=wp.vec3),
    own: wp.array(dtype=wp.vec3),
):
    i = begin + wp.tid()
    shape = int(shapes[i / count])
    k = i % count
    number = (first + shapes[i / count]) * wp.int64(count) + wp.int64(k)
    a = philox(counter_of(number, 0, 0), low, high)
    b = philox(counter_of(number, 1, 0), low, high)
    centre = scene.places[shape]
    if k < law.near:
        along = (wp.float64(k) + wp.float64(unit_float(a[0]))) / wp.float64(law.near)
        face = face_at(scene, shape, scene.area_before[shape] + along * scene.area_size[shape])
        root = wp.sqrt(unit_float(a[1]))
        share = unit_float(a[2])
        at = (
            (1.0 - root) * scene.corners[3 * face]
            + root * (1.0 - share) * scene.corners[3 * face + 1]
            + root * share * scene.corners[3 * face + 2]
        )
        one = normal_pair(unit_float(a[3]), unit_float(b[0]))
        other = normal_pair(unit_float(b[1]), unit_float(b[2]))
        at = at + wp.where(k % 2 == 0, law.wide, law.tight) * wp.vec3(one[0], other[0], one[1])
        # Tails of the normal distribution reach out of the box: back into it, where only own triangles are nearest.
        at = at - centre
        for axis in range(3):
            at[axis] = wp.clamp(at[axis], -law.reach, law.reach)
        in_scene[i] = at + centre
    else:
        uniform = wp.vec3(unit_float(a[0]), unit_float(a[1]), unit_float(a[2]))
        in_scene[i] = law.box * (2.0 * uniform - wp.vec3(1.0, 1.0, 1.0)) + centre
    own[i] = in_scene[i] - centre


def draw(
    scene: Scene,
    law: Law,
    seed: int,
    first: int,
    shapes: wp.array,
    count: int,
    in_scene: wp.array,
    own: wp.array,
) -> None:
    """Draw `count` samples of each of `shapes` (B,) int64.

    Args:
        scene: The shapes.
        law: Where samples are.
        seed: Whole number of 64 bits.
        first: The step times the number of shapes; samples are numbered by it, the shape, and their place.
        shapes: (B,) int64.
        count: Samples of each.
        in_scene: (B * count,) vec3, filled: their places in the scene.
        own: (B * count,) vec3, filled: their places as seen from their shape's middle.
    """
    words = wp.uint32(seed & 0xFFFFFFFF), wp.uint32((seed >> 32) & 0xFFFFFFFF)
    inputs = [scene, law, *words, wp.int64(first), shapes, count, in_scene, own]
    launch(_draw, shapes.shape[0] * count, inputs, shapes.device)
