"""A left atrium that a shape model never saw, from an image: its label map, blurred and made noisy.

    python -m sdm.bench.shapes.atrium_fit --data ../shared/data --out bench/results/fit-atria.json

For each atrium of the validation set a model is made of all others but itself, its double and its near twins (the same
atrium at another time); its modes and a pose are fitted to the image (`fit_family`), and then the vertices go on freely
(`free_form`). The same modes are fitted to points of the surface, too (`fit_points`): 2,000, half a voxel off in each
direction. Distances are means over both ways from the smooth surface of the atrium's label. Beside them: the
projection of the true surface on the modes, by the vertices of the template laid onto it, and the level set of the
image halfway between the intensities, as it is and after a Gaussian of one voxel.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from sdm.bench.common.checkout import results_folder
from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.deepsdf.shapes import SPACING_MM, atria, left_out_labels
from sdm.bench.deepsdf.study.atria_split import duplicates_of, read_record, twins_of
from sdm.core.device import choose_device
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.random import generator
from sdm.core.signed_distance_map import SDM
from sdm.deepsdf.samples.label_surface import label_surface, largest_component
from sdm.engine.mesh_index import MeshIndex
from sdm.fit.model.exact import ExactBackend
from sdm.fit.model.scaled_family import factor_of
from sdm.fit.solve.fit_family import fit_family, usual_options
from sdm.fit.solve.fit_points import fit_points
from sdm.fit.solve.free_form import free_form
from sdm.shapes.models.build_model import model_of
from sdm.shapes.models.even_template import even_template
from sdm.shapes.models.lay_template import TemplateLayer, surface_samples

INSIDE, OUTSIDE = 1000.0, 0.0
MARGIN, POINTS = 8, 4000
# Points that are fitted, and the standard deviation of their noise along each axis [voxels].
SCANNED, SCATTER = 2000, 0.5


def main(words: list[str] | None = None) -> None:
    """Lay a template onto all atria, then fit each that is left out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="the data folder, or its packed file")
    parser.add_argument("--out", type=Path, default=results_folder() / "fit-atria.json")
    parser.add_argument("--count", type=int, default=8, help="atria to leave out, of the validation set's 8")
    parser.add_argument("--training", type=int, default=None, help="of the other 72, so many (default: all)")
    parser.add_argument("--triangles", type=int, default=8000)
    parser.add_argument("--modes", type=int, default=16)
    parser.add_argument("--noise", type=float, default=0.2, help="standard deviation, as a share of the contrast")
    parser.add_argument("--blur", type=float, default=1.0, help="standard deviation [voxels]")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--cache", type=Path, default=None, help="keeps the surfaces for the next time")
    parser.add_argument("--laid", type=Path, default=None, help="as sdm.bench.shapes.atria --laid left it: all of them")
    parser.add_argument("--resume", action="store_true", help="keep the atria in --out, fit the others")
    parser.add_argument("--budget-s", type=float, default=float("inf"), help="begin no fit after this long")
    options = parser.parse_args(words)
    begin, device = time.perf_counter(), choose_device(options.device)
    record = read_record()
    doubles = set(duplicates_of(record))
    masks = left_out_labels(options.data, options.count)
    if options.laid is None:
        names, points, faces = _laid(options, doubles, device)
    else:
        known = torch.load(options.laid, weights_only=True)
        names, faces = list(known["points"]), known["faces"]
        points = torch.stack([known["points"][name] for name in names]).double()
    print(f"{len(names)} atria, a template laid on each: {time.perf_counter() - begin:.0f} s", flush=True)
    rows = _before(options)
    done = {row["name"] for row in rows}
    for number, (name, mask) in enumerate(masks.items()):
        if time.perf_counter() - begin > options.budget_s:
            break
        if name in done:
            continue
        mesh = label_surface(mask, SPACING_MM)
        away = twins_of(record, [name]) | {name} | doubles
        kept = [i for i, other in enumerate(names) if other not in away]
        modes = min(options.modes, len(kept) - 1)
        model = model_of(points[kept], faces, scale=False, modes=modes, limit=3.0, facts={})
        image, grid = image_of(mask, options.blur, options.noise, number)
        row = {"name": name, "of": len(kept), **_fitted(model, mesh, image, grid, options, device)}
        row |= {"projection_mm": projection(model, points[names.index(name)], mesh, device)}
        rows.append(row | _from_points(model, mesh, number, device))
        print(rows[-1], flush=True)
        write(options.out, {
            "machine": describe(str(device)), "voxel_mm": SPACING_MM, "blur_voxels": options.blur,
            "noise_of_contrast": options.noise, "points": SCANNED, "scatter_voxels": SCATTER, "modes": options.modes,
            "triangles": len(faces), "mean": _means(rows), "atria": rows,
        })  # fmt: skip
    print(_means(rows))


def _before(options: Any) -> list[dict[str, Any]]:
    """Atria of an earlier run in the file, with `--resume`."""
    if not options.resume or not options.out.is_file():
        return []
    return json.loads(options.out.read_text())["atria"]


def _means(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Of what all rows have."""
    keys = [key for key in rows[0] if key.endswith(("_mm", "_s")) and all(key in row for row in rows)]
    return {key: round(float(np.mean([row[key] for row in rows])), 4) for key in keys}


def _laid(options: Any, doubles: set[str], device: Any) -> tuple[list[str], Tensor, Tensor]:
    """A template of the training atria's middle volume on all: names, vertices (N,V,3) and faces."""
    found = atria(options.data, options.training, options.count, cache=options.cache)
    others = [mesh for mesh in found.training if mesh.name not in doubles]
    volumes = [_volume(mesh) for mesh in others]
    middle = sorted(range(len(others)), key=volumes.__getitem__)[len(others) // 2]
    layer = TemplateLayer(even_template(others[middle], options.triangles, device), device)
    meshes = [*others, *found.test]
    points = torch.stack([layer.lay(mesh).vertices.cpu() for mesh in meshes]).double()
    return [mesh.name for mesh in meshes], points, layer.faces.cpu()


def image_of(mask: Tensor, blur: float, noise: float, number: int) -> tuple[Tensor, Grid]:
    """A label map cropped to its atrium, blurred, with white noise: a pure function of the number."""
    from scipy.ndimage import gaussian_filter

    place = mask.nonzero()
    low = (place.amin(0) - MARGIN).clamp_min(0)
    high = torch.minimum(place.amax(0) + 1 + MARGIN, torch.tensor(mask.shape))
    part = mask[tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))]
    smooth = torch.from_numpy(gaussian_filter(part.double().numpy(), blur))
    white = torch.randn(part.shape, generator=generator(number, "noise of an atrium"), dtype=torch.float64)
    values = OUTSIDE + (INSIDE - OUTSIDE) * (smooth + noise * white)
    return values, Grid([SPACING_MM * int(a) for a in low], (SPACING_MM,) * 3, tuple(part.shape))


def _fitted(model: Any, mesh: TriangleMesh, image: Tensor, grid: Grid, options: Any, device: Any) -> dict[str, Any]:
    blur = options.blur * SPACING_MM
    start = time.perf_counter()
    own = usual_options(grid, factor_of(model), blur=blur)
    result = fit_family(image, grid, model, options=own, device=device)
    fitted = result.state.to_world(model.reference_vertices(result.state.theta[None].cpu())[0].to(device).double())
    surface = TriangleMesh(fitted.float(), model.triangles.to(device), check=False)
    middle = time.perf_counter()
    free = free_form(image, grid, surface, blur=blur, device=device)
    end = time.perf_counter()
    return {
        "modes_mm": distance(surface, mesh, device),
        "free_form_mm": distance(free.mesh, mesh, device),
        "level_set_mm": distance(_level_set(image, grid, 0.0), mesh, device),
        "smoothed_level_set_mm": distance(_level_set(image, grid, 1.0), mesh, device),
        "explained": round(result.diagnosis.explained, 4),
        "trusted": result.trusted,
        "problems": list(result.diagnosis.problems),
        "noise": round(free.noise, 2),
        "fit_s": round(middle - start, 2),
        "free_form_s": round(end - middle, 2),
    }


def _from_points(model: Any, mesh: TriangleMesh, number: int, device: Any) -> dict[str, Any]:
    """The modes and a pose by points of the surface with noise: a pure function of the number."""
    scan = scan_of(mesh, number, device)
    start = time.perf_counter()
    found = fit_points(scan, ExactBackend(model, device))
    end = time.perf_counter()
    state = found.posterior.state
    vertices = state.to_world(model.reference_vertices(state.theta[None].cpu())[0].to(device).double())
    surface = TriangleMesh(vertices.float(), model.triangles.to(device), check=False)
    return {
        "points_mm": distance(surface, mesh, device),
        "points_noise_mm": round(found.noise, 4),
        "points_converged": found.converged,
        "points_s": round(end - start, 2),
    }


def scan_of(mesh: TriangleMesh, number: int, device: Any) -> Tensor:
    """Points (N,3) of a surface with noise: a pure function of the number."""
    noise = torch.randn(SCANNED, 3, generator=generator(number, "noise of points of an atrium"))
    return surface_samples(mesh, SCANNED, 5, device)[0] + SCATTER * SPACING_MM * noise.to(device)


def _level_set(image: Tensor, grid: Grid, smoothing: float) -> TriangleMesh:
    """The largest part of the surface halfway between the intensities."""
    from scipy.ndimage import gaussian_filter

    values = gaussian_filter(image.numpy(), smoothing) if smoothing else image.numpy()
    return largest_component(SDM(torch.from_numpy((INSIDE + OUTSIDE) / 2 - values).float(), grid).to_mesh())


def projection(model: Any, points: Tensor, mesh: TriangleMesh, device: Any) -> float:
    """Distance of the model's shape whose vertices are nearest to those of the template on the atrium itself."""
    from sdm.shapes.models.procrustes import rotations

    own, mean = points - points.mean(0), model.mean.double() - model.mean.double().mean(0)
    turn = rotations(own[None], mean)[0]
    theta = model.project((own @ turn + model.mean.double().mean(0))[None].float())
    shape = model.reference_vertices(theta.double())[0]
    back = (shape - model.mean.double().mean(0)) @ turn.T + points.mean(0)
    return distance(TriangleMesh(back.float(), model.triangles, check=False), mesh, device)


def distance(one: TriangleMesh, other: TriangleMesh, device: Any) -> float:
    """Mean distance of two surfaces, the mean of both ways [mm]."""
    ways = []
    for a, b in ((one, other), (other, one)):
        samples = surface_samples(a, POINTS, 4, device)[0]
        index = MeshIndex(TriangleMesh(b.vertices, b.faces, check=False), device=device)
        ways.append(index.signed_distance(samples, sign="none").abs().mean())
    return round(float(sum(ways) / 2), 4)


def _volume(mesh: TriangleMesh) -> float:
    a, b, c = mesh.vertices.double()[mesh.faces.long()].unbind(1)
    return float((a * torch.linalg.cross(b, c)).sum() / 6)


if __name__ == "__main__":
    main()
