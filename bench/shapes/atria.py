"""Shape models of left atria: points laid by a template beside maps, on the same leave-one-out study.

    python -m sdm.bench.shapes.atria --data ../shared/data --out bench/results/shape-model-atria.json
    python -m sdm.bench.shapes.atria --data ../shared/data --laid laid.pt --model atria.npz --modes 10 --parts model

With --laid the template's vertices on each atrium are kept, so that a run that was cut short goes on. Labels become
smooth surfaces; the case that is there twice is left out. For both models the generalisation is the mean distance, both
ways, of a left-out atrium's surface from the nearest shape of the model of the others, for 1, 2, ... modes; the
specificity that of random shapes of the model from the nearest atrium. Compactness is the share of variance.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from sdm.bench.common.checkout import results_folder
from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.deepsdf.shapes import atria
from sdm.bench.deepsdf.study.atria_split import duplicates_of, read_record
from sdm.core.device import choose_device
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.random import generator
from sdm.core.signed_distance_map import SDM
from sdm.engine.api import signed_distance_map
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import SDMError
from sdm.io.files.torch_file import save_torch
from sdm.shapes.models.build_model import model_of, principal_components
from sdm.shapes.models.even_template import even_template
from sdm.shapes.models.lay_template import TemplateLayer, surface_samples
from sdm.shapes.models.procrustes import procrustes, rotations
from sdm.shapes.models.sdm_modes import modes_of
from sdm.shapes.models.statistical_shape import LIMIT

MODES = (1, 2, 4, 8, 16, 32)
POINTS, DRAWN = 2000, 40
# Points by which the nearest atria are looked for, one way.
FEW = 500
KEEP_S = 20.0


def main(words: list[str] | None = None) -> None:
    """Build both models and measure them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="the data folder, or its packed file")
    parser.add_argument("--out", type=Path, default=results_folder() / "shape-model-atria.json")
    parser.add_argument("--count", type=int, default=None, help="how many atria (default: all)")
    parser.add_argument("--triangles", type=int, default=6000)
    parser.add_argument("--resolution", type=int, default=64, help="of the maps")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--cache", type=Path, default=None, help="keeps the surfaces for the next time")
    parser.add_argument("--laid", type=Path, default=None, help="keeps what is laid, atrium by atrium")
    parser.add_argument("--model", type=Path, default=None, help="write the model of points here too")
    parser.add_argument("--modes", type=int, default=None, help="of that model (default: 98 %% of the variance)")
    parser.add_argument("--parts", nargs="+", choices=("model", "curves"), default=["model", "curves"])
    options = parser.parse_args(words)
    device = choose_device(options.device)
    found = atria(options.data, cache=options.cache)
    twice = set(duplicates_of(read_record()))
    meshes = [mesh for mesh in (*found.training, *found.test) if mesh.name not in twice][: options.count]
    points, faces, rows = _laid(meshes, options, device)
    model = model_of(points, faces, scale=False, modes=options.modes, limit=LIMIT, facts={"shapes": rows})
    if options.model is not None:
        model.save(options.model)
    distances = torch.tensor([row["distance"] for row in rows])
    print(
        f"{len(rows)} atria in {sum(row['seconds'] for row in rows):.1f} s: {distances.mean():.3f} mm on average, "
        f"the worst {distances.max():.3f}; {sum(row['turned'] for row in rows)} faces turned, "
        f"{sum(row['cut'] for row in rows)} in another part",
        flush=True,
    )
    record = {
        "machine": describe(str(device)),
        "count": len(rows),
        "triangles": len(faces),
        "mean_mm": round(float(distances.mean()), 4),
        "worst_mm": round(float(distances.max()), 4),
        "turned": sum(row["turned"] for row in rows),
        "cut": sum(row["cut"] for row in rows),
        "seconds": round(sum(row["seconds"] for row in rows), 1),
        "registration": rows,
        "vertex_measures": {key: model.facts[key] for key in ("compactness", "generalisation", "specificity")},
    }
    write(options.out, record)
    if "curves" not in options.parts:
        return
    write(options.out, record := {**record, **_compared(meshes, points, faces, options, device)})
    if options.out.suffix == ".json":
        from sdm.bench.shapes.picture import draw

        draw(record, options.out.with_suffix(".png"))


def _laid(
    meshes: list[TriangleMesh], options: Any, device: torch.device
) -> tuple[Tensor, Tensor, list[dict[str, Any]]]:
    """Vertices (N,V,3) of an even template on each atrium, its faces, and how far it is from each.

    As `build_model` does it, but what a run before has laid is taken from its file.
    """
    volumes = [float(_volume(mesh)) for mesh in meshes]
    middle = meshes[sorted(range(len(meshes)), key=volumes.__getitem__)[len(meshes) // 2]]
    known: dict[str, Any] = {"rows": {}, "points": {}}
    if options.laid is not None and options.laid.is_file():
        known = torch.load(options.laid, weights_only=True)
        if known["template"] != [middle.name, options.triangles]:
            raise SystemExit(f"{options.laid} is of another template: choose another file with --laid")
        template = TriangleMesh(known["vertices"], known["faces"], check=False)
    else:
        template = even_template(middle, options.triangles, device)
    known |= {"template": [middle.name, options.triangles]}
    known |= {"vertices": template.vertices.cpu(), "faces": template.faces.cpu()}
    layer = TemplateLayer(template, device)
    kept = time.perf_counter()
    for mesh in meshes:
        if mesh.name in known["rows"]:
            continue
        start = time.perf_counter()
        laid = layer.lay(mesh)
        known["points"][mesh.name] = laid.vertices.cpu()
        known["rows"][mesh.name] = row = {
            "name": mesh.name,
            "distance": round(laid.distance, 5),
            "most": round(laid.most, 4),
            "turned": laid.turned,
            "cut": laid.cut,
            "seconds": round(time.perf_counter() - start, 2),
        }
        print(f"{len(known['rows'])} of {len(meshes)}: {row}", flush=True)
        if options.laid is not None and (time.perf_counter() - kept > KEEP_S or mesh is meshes[-1]):
            save_torch(known, options.laid)
            kept = time.perf_counter()
    points = torch.stack([known["points"][mesh.name] for mesh in meshes])
    return points, known["faces"], [known["rows"][mesh.name] for mesh in meshes]


def _compared(
    meshes: list[TriangleMesh], laid: Tensor, faces: Tensor, options: Any, device: torch.device
) -> dict[str, Any]:
    """Both models' curves by distances of surfaces, of the same aligned atria."""
    points, faces = laid.to(device).double(), faces.to(device)
    aligned, _ = procrustes(points)
    moved = [_moved(mesh, own, goal, device) for mesh, own, goal in zip(meshes, points, aligned, strict=True)]
    every = torch.cat([mesh.vertices for mesh in moved])
    grid = Grid.around(TriangleMesh(every, moved[0].faces, check=False), resolution=options.resolution, margin=0.1)
    maps = torch.stack([signed_distance_map(mesh, grid, device=device).values for mesh in moved])
    indices = [MeshIndex(mesh, device=device) for mesh in moved]
    samples = [surface_samples(mesh, POINTS, 3, device)[0] for mesh in moved]
    modes = [m for m in MODES if m <= len(meshes) - 2]
    curves = {"points": _curve_of_points(aligned, faces, indices, samples, modes)}
    print(f"points: {curves['points']['generalisation']}, specificity {curves['points']['specificity']}", flush=True)
    curves["maps"] = _curve_of_maps(maps, grid, indices, samples, modes)
    # Half a voxel is what the zero level of an interpolated map may be off by itself.
    return {"modes": modes, "voxel": round(grid.spacing[0], 4), "curves": curves}


def drawn_codes(modes: int) -> torch.Tensor:
    """Codes (DRAWN,modes) of shapes of a model, in its deviations; the same ones for each way to make it."""
    return torch.randn(DRAWN, modes, generator=generator(0, "specificity of atria"))


def _curve_of_points(
    aligned: Tensor, faces: Tensor, indices: list[MeshIndex], samples: list[Tensor], modes: list[int]
) -> dict[str, Any]:
    errors = []
    for out in range(len(aligned)):
        others = torch.cat([aligned[:out], aligned[out + 1 :]])
        mean = others.mean(0)
        basis, _ = principal_components(others - mean)
        own = basis.flatten(1) @ (aligned[out] - mean).reshape(-1)
        row = []
        for m in modes:
            shape = mean + torch.einsum("m,mvc->vc", own[:m], basis[:m])
            row.append(_distance(TriangleMesh(shape.float(), faces, check=False), indices[out], samples[out]))
        errors.append(row)
    mean = aligned.mean(0)
    basis, deviations = principal_components(aligned - mean)
    theta = drawn_codes(len(deviations)).to(aligned) * deviations
    drawn = [
        [TriangleMesh((mean + torch.einsum("m,mvc->vc", t[:m], basis[:m])).float(), faces, check=False) for t in theta]
        for m in modes
    ]
    return {**_summary(errors), "compactness": _shares(deviations), "specificity": _nearest(drawn, indices, samples)}


def _curve_of_maps(
    maps: Tensor, grid: Grid, indices: list[MeshIndex], samples: list[Tensor], modes: list[int]
) -> dict[str, Any]:
    errors = []
    for out in range(len(maps)):
        model = modes_of(torch.cat([maps[:out], maps[out + 1 :]]), grid, len(maps) - 2, {})
        theta = model.project(maps[out])
        errors.append([_distance(_surface(model.map(theta[:m])), indices[out], samples[out]) for m in modes])
    model = modes_of(maps, grid, len(maps) - 1, {})
    theta = drawn_codes(len(model.deviations)).to(maps.device)
    drawn = [[_surface(model.map(t[:m])) for t in theta] for m in modes]
    shares = _shares(model.deviations.double())
    return {**_summary(errors), "compactness": shares, "specificity": _nearest(drawn, indices, samples)}


def _surface(field: SDM) -> TriangleMesh | None:
    """The zero level, None where there is none."""
    try:
        return field.to_mesh()
    except SDMError:
        return None


def _distance(mesh: TriangleMesh | None, index: MeshIndex, samples: Tensor) -> float:
    """Mean distance of two surfaces, the mean of both ways."""
    if mesh is None:
        return float("nan")
    there = index.signed_distance(surface_samples(mesh, POINTS, 4, samples.device)[0], sign="none").mean()
    back = MeshIndex(mesh, device=samples.device).signed_distance(samples, sign="none").mean()
    return float((there + back) / 2)


def _nearest(
    drawn: Sequence[Sequence[TriangleMesh | None]], indices: list[MeshIndex], samples: list[Tensor]
) -> list[float]:
    """Mean over random shapes of the distance from the nearest atrium: both ways to the five nearest one way."""
    found = []
    for shapes in drawn:
        row = []
        for mesh in shapes:
            if mesh is None:
                continue
            points = surface_samples(mesh, FEW, 5, samples[0].device)[0]
            one_way = torch.stack([index.signed_distance(points, sign="none").mean() for index in indices])
            near = one_way.argsort()[:5].tolist()
            row.append(min(_distance(mesh, indices[n], samples[n]) for n in near))
        found.append(round(sum(row) / max(1, len(row)), 4))
    return found


def _summary(errors: list[list[float]]) -> dict[str, Any]:
    table = torch.tensor(errors)
    return {
        "generalisation": [round(x, 4) for x in table.nanmean(0).tolist()],
        "generalisation_worst": [round(x, 4) for x in table.nan_to_num(0).amax(0).tolist()],
    }


def _shares(deviations: Tensor) -> list[float]:
    shares = deviations.square().cumsum(0) / deviations.square().sum()
    return [round(float(x), 5) for x in shares]


def _volume(mesh: TriangleMesh) -> Tensor:
    a, b, c = mesh.vertices.double()[mesh.faces.long()].unbind(1)
    return (a * torch.linalg.cross(b, c)).sum() / 6


def _moved(mesh: TriangleMesh, own: Tensor, goal: Tensor, device: torch.device) -> TriangleMesh:
    """A mesh moved as its template was by the alignment."""
    a, b = own - own.mean(0), goal - goal.mean(0)
    turn = rotations(a[None], b)[0]
    vertices = (mesh.vertices.to(device).double() - own.mean(0)) @ turn + goal.mean(0)
    return TriangleMesh(vertices.float(), mesh.faces.to(device), mesh.name, check=False)


if __name__ == "__main__":
    main()
