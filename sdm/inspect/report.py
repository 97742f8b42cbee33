"""The triage report of a mesh."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.inspect.agreement import agreeing_turns
from sdm.inspect.components import components_of
from sdm.inspect.degenerate import zero_area
from sdm.inspect.duplicates import first_copies
from sdm.inspect.edges import edges_of
from sdm.inspect.facts_table import facts_table
from sdm.inspect.orientation import inside_out, to_turn
from sdm.inspect.positions import first_at_position
from sdm.inspect.problems import problems_of, sign_problems
from sdm.inspect.recommendation import recommended_sign
from sdm.inspect.rounding import lost_digits


@dataclass(frozen=True)
class MeshReport:
    """Properties of a mesh. Vertices at exactly equal positions count as one throughout.

    Args:
        name: The mesh's name.
        triangles: Number of faces.
        vertices: Number of vertices as the mesh has them.
        bounds: Lowest and highest x, y, z, in the mesh's unit.
        closed: The directed edges of all faces cancel. The winding number is then a whole number everywhere, which
            is what the sign of a distance needs; shells that touch along an edge are closed too.
        watertight: No edge belongs to one face alone. A watertight mesh with a turned face is not closed.
        oriented: Faces that share an edge agree which side is out.
        outward: Whether closed components face outward (cavities inward). None where that says nothing: the mesh is
            not closed, or encloses no volume.
        manifold: Around every edge there are at most two faces, and around every vertex one fan of them.
        components: Pieces that edges hold together.
        inside_out: All that encloses a volume, closed or nearly, is inside out.
        inside_out_components: Closed and nearly closed pieces that face inward and are not cavities.
        degenerate_faces: Faces whose area is exactly zero, repeated vertices included.
        duplicate_faces: Faces with the same three positions as an earlier one, in any order.
        boundary_edges: Edges of one face.
        disagreeing_edges: Edges whose faces do not agree which side is out; of several copies of a face that face the
            same way one counts.
        disagreeing_pairs: Those of them with two faces, of which one is turned or the surface is one-sided.
        turned_area: The share of the area that is turned against the rest of its patch, at most a half.
        nonmanifold_edges: Edges of three faces or more.
        nonmanifold_vertices: Vertices at which separate fans of faces meet.
        volume: Signed volume in cubic units, negative if inside out; None for meshes that are not closed.
        area: Total area in square units, repeated faces included.
        shut_area: The share of the area that belongs to components that are closed, or open by little.
        recommended_sign: The `sign` of `sdm.signed_distance_map` that suits the mesh: "winding", "flood" or "none".
        recommendation: Why, in a sentence.
        problems: What deserves attention, in plain sentences; empty for a clean mesh.
    """

    name: str
    triangles: int
    vertices: int
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]]
    closed: bool
    watertight: bool
    oriented: bool
    outward: bool | None
    manifold: bool
    components: int
    inside_out: bool
    inside_out_components: int
    degenerate_faces: int
    duplicate_faces: int
    boundary_edges: int
    disagreeing_edges: int
    disagreeing_pairs: int
    turned_area: float
    nonmanifold_edges: int
    nonmanifold_vertices: int
    volume: float | None
    area: float
    shut_area: float
    recommended_sign: str
    recommendation: str
    problems: list[str]

    @property
    def sign_problems(self) -> list[str]:
        """Those of the problems for which the sign of a map is probably not what was meant."""
        return sign_problems(asdict(self))

    def _repr_html_(self) -> str:
        facts = asdict(self)
        told = {"name", "problems", "bounds", "recommendation", "recommended_sign"}
        shown = {name.replace("_", " "): value for name, value in facts.items() if name not in told}
        shown |= {"box": " to ".join(f"({', '.join(f'{x:.4g}' for x in corner)})" for corner in self.bounds)}
        notes = self.problems or ["nothing deserves attention"]
        return facts_table(self.name, shown, [*notes, f"sign={self.recommended_sign!r}: {self.recommendation}"])

    def as_dict(self) -> dict[str, Any]:
        """The fields by name, ready for JSON."""
        return asdict(self)


def inspect_mesh(mesh: MeshLike) -> MeshReport:
    """Look a mesh over. Counts are exact; a million triangles take about two seconds on one core.

    Args:
        mesh: Any mesh, on any device, or whatever `as_mesh` takes for one.

    Returns:
        A `MeshReport`. Lengths, areas and volumes are in the mesh's own unit.

    Raises:
        MeshError: What is given is no mesh, or one that cannot be used.
    """
    mesh = as_mesh(mesh)
    vertices, faces = mesh.numpy()
    merged = first_at_position(vertices)[faces.astype(np.int64)]
    edges = edges_of(merged, len(vertices))
    corners = vertices[faces]
    low, high = mesh.bounds
    exact = corners.astype(np.float64)
    components = components_of(exact, merged, edges.component, edges.open_components)

    closed = not edges.chain.any()
    volume = float(components.volume.sum())
    wrong, unjudged = inside_out(exact, components)
    nonmanifold = int((edges.uses > 2).sum())
    boundary = int((edges.uses == 1).sum())
    first, same_side = first_copies(merged, len(vertices))
    distinct = (first == np.arange(len(faces))) | ~same_side
    single = edges if distinct.all() else edges_of(merged[distinct], len(vertices))
    disagreeing = int(single.disagreeing.sum())

    facts: dict[str, Any] = {
        "name": mesh.name,
        "triangles": len(faces),
        "vertices": len(vertices),
        "bounds": (tuple(low.tolist()), tuple(high.tolist())),
        "closed": closed,
        "watertight": boundary == 0,
        "oriented": disagreeing == 0,
        "outward": (volume > 0 and wrong == 0) if closed and volume != 0 else None,
        "manifold": nonmanifold == 0 and edges.split_vertices == 0,
        "components": edges.components,
        "inside_out": wrong > 0 and bool(to_turn(exact, components)[components.volume != 0].all()),
        "inside_out_components": wrong,
        "degenerate_faces": int(zero_area(corners).sum()),
        "duplicate_faces": int((first != np.arange(len(faces))).sum()),
        "boundary_edges": boundary,
        "disagreeing_edges": disagreeing,
        "disagreeing_pairs": int((single.disagreeing & (single.uses == 2)).sum()),
        "turned_area": 0.0,
        "nonmanifold_edges": nonmanifold,
        "nonmanifold_vertices": edges.split_vertices,
        "volume": volume if closed else None,
        "area": float(components.area.sum()),
    }
    if facts["disagreeing_pairs"]:
        area = np.linalg.norm(np.cross(exact[:, 1] - exact[:, 0], exact[:, 2] - exact[:, 0]), axis=1)
        # Faces without an area have none to turn.
        facts["turned_area"] = float(area[agreeing_turns(merged, area)[0]].sum() / (area.sum() or 1.0))
    facts["shut_area"] = float(components.area[components.nearly_closed].sum() / (facts["area"] or 1.0))
    facts["recommended_sign"], facts["recommendation"] = recommended_sign(facts)
    return MeshReport(**facts, problems=[*problems_of(facts, unjudged), *lost_digits(mesh)])
