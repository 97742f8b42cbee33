"""Winding data of the open meshes of a list, built together for their points."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import torch
import warp as wp

from sdm.engine.ragged.structure import RaggedStructure
from sdm.engine.structure.sizes import MeshKind
from sdm.kernels.bvh.build import build_in_frame
from sdm.kernels.bvh.tree import BOX_FLOATS, DEPTH, PART_SIZE, Tree
from sdm.kernels.launch import set_array
from sdm.kernels.points.edge_signs import is_summed
from sdm.kernels.points.open_meshes import (
    CAPS,
    DIPOLES,
    EDGES,
    FIRST_EDGE,
    ROW,
    SIXTEENS,
    OpenMeshes,
    build_dipoles,
    gather_edges,
)
from sdm.kernels.primitives.wide_numbers import SIXTEEN
from sdm.kernels.winding.cap_tree import depth_of_caps
from sdm.kernels.winding.dipole_tree import MOMENTS_SIZE
from sdm.runtime.torch_warp import as_warp, on_current_stream, repeated_row, to_device, workspace
from sdm.topology.joint_boundaries import JointBoundaries, caps_of

# Kinds whose caps points look at, too, besides their edges.
SEEN = frozenset((MeshKind.OPEN, MeshKind.MANY))


class OpenData:
    """Winding data for points of open meshes of a structure.

    Args:
        structure: Of some meshes.
        found: Their boundaries.
        places: Those that are asked about, by their places there, from low to high; none is closed.

    Attributes:
        view: The arrays for kernels.
        sixteens: Rows of sixteen edges that hold those of all meshes whose edges are visited.
        memory: The tensors that they are parts of, to live until the last kernel that uses them is queued.
    """

    def __init__(self, structure: RaggedStructure, found: JointBoundaries, places: Sequence[int]) -> None:
        device = structure.memory.device
        kinds, counts, meshes = structure.kinds, found.counts, structure.rows
        seen = [i for i in places if kinds[i] in SEEN]
        # As single calls have it: the others go down trees of dipoles.
        others = [i for i in places if kinds[i] not in SEEN]
        by_sums = [is_summed(kinds[i], counts[i], device.type == "cuda") for i in others]
        summed = seen + [i for i, is_one in zip(others, by_sums, strict=True) if is_one]
        dipoles = [i for i, is_one in zip(others, by_sums, strict=True) if not is_one]
        edges = [counts[i] for i in summed]
        levels = [depth_of_caps(counts[i]) for i in seen]
        first_edges, roots = [0, *accumulate(edges)], [0, *accumulate([2 << level for level in levels])]
        sixteens = [0, *accumulate([-(-count // SIXTEEN) for count in edges])]
        nodes = [0, *accumulate([2 << meshes[i][DEPTH] for i in dipoles])]
        rows = [[int(kinds.get(i, MeshKind.CLOSED)), *[0] * (ROW - 1)] for i in range(len(meshes))]
        for k, i in enumerate(summed):
            rows[i][FIRST_EDGE], rows[i][EDGES], rows[i][SIXTEENS] = first_edges[k], edges[k], sixteens[k]
        for k, i in enumerate(seen):
            rows[i][CAPS] = k
        for k, i in enumerate(dipoles):
            rows[i][DIPOLES] = nodes[k]
        # Of trees one at least, which nobody looks at.
        parts = [[first_edges[k], edges[k], levels[k], roots[k], 0] for k in range(len(seen))] or [[0] * PART_SIZE]
        # One copy for all.
        tables = [[x for row in table for x in row] for table in (rows, parts)] + [summed, edges, dipoles]
        lengths = [len(table) for table in tables]
        joined = torch.tensor([x for table in tables for x in table], dtype=torch.int32, device="cpu")
        table, trees, of_summed, of_edges, with_dipoles = to_device(joined, device).split(lengths)
        of_seen, slots = of_summed[: len(seen)], first_edges[len(seen)]
        visited = found.of_some(summed)
        caps = caps_of(visited[:slots], structure.vertices.shape[0])
        owners = of_summed.repeat_interleave(of_edges, output_size=first_edges[-1])
        frames = structure.frames[of_seen].view(-1)
        bounds = structure.bounds.view(-1, 6)[of_seen].view(-1)
        empty: Any = workspace(device)
        self.sixteens = sixteens[-1]
        self.view, self.memory = OpenMeshes(), (joined, table, trees, visited, caps, owners, frames, bounds, empty)
        view, tree = self.view, Tree()
        tensors = structure.memory, structure.parts, structure.vertices, table, visited, caps, owners, frames, bounds
        with on_current_stream(structure.vertices, *tensors):
            set_array(view, "rows", as_warp(table, wp.int32))
            set_array(view, "ends", empty(2 * first_edges[-1], wp.vec3))
            set_array(view, "lattice", empty(2 * first_edges[-1], wp.vec2i))
            set_array(view, "moments", empty(nodes[-1] * MOMENTS_SIZE, wp.float32))
            arrays = {
                "corners": empty(4 * slots, wp.vec3),
                "lattice": empty(3 * slots, wp.vec2i),
                "face": empty(slots, wp.int32),
                "boxes": empty(roots[-1] * BOX_FLOATS, wp.float32),
                "frame": as_warp(frames, wp.float64),
                "parts": as_warp(trees, wp.int32),
            }
            for name, array in arrays.items():
                set_array(tree, name, array)
            tree.count = max(edges[: len(seen)], default=0)
            tree.depth, tree.meshes = max(levels, default=0), len(parts)
            view.caps = tree
            vertices = as_warp(structure.vertices, wp.vec3)
            gather_edges(structure.view.tree, vertices, as_warp(visited, wp.int32), as_warp(owners, wp.int32), view)
            if seen:
                corners = repeated_row(as_warp(structure.vertices[None], wp.vec3), len(seen))
                keys, order = empty(2 * slots, wp.int64), empty(2 * slots, wp.int32)
                box, normals = as_warp(bounds, wp.float32), empty(4 * slots, wp.float32)
                build_in_frame(tree, corners, as_warp(caps, wp.int32), box, keys, order, normals)
            if dipoles:
                depth = max(meshes[i][DEPTH] for i in dipoles)
                build_dipoles(structure.view.tree, view, as_warp(with_dipoles, wp.int32), depth)
