"""Nonsense for each argument of public calls: objects, empty containers, text for numbers, numbers for paths."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

import sdm
import sdm.compat.igl
import sdm.compat.mesh_to_sdf
from sdm.core.given_values import real, whole
from sdm.errors import SDMError

MESH = sdm.TriangleMesh(
    [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], "tetrahedron"
)
GRID = sdm.Grid.around(MESH, 5)
POINTS = np.zeros((2, 3))
# Nothing that any argument takes.
OBJECTS = (object(), {}, [], 1j, b"x", lambda: 0)
NUMBERS = (*OBJECTS, "nonsense", float("nan"), -1, torch.zeros(2), 10**400)
LENGTHS = (*NUMBERS, float("inf"))
PATHS = (*OBJECTS[:-2], 3, None, MESH, "", "null\0.npz", "null\0.ply")
NO_MESHES = (object(), 1j, None, 3, "nonsense", GRID, POINTS, (POINTS, None), (POINTS[:0], np.zeros((0, 3), int)))
MESHES = (*OBJECTS, *NO_MESHES)
GRIDS = (*OBJECTS, None, "nonsense", float("nan"), -3, 0, [1, 2], ["a", "b", "c"], MESH)
DEVICES = (*OBJECTS[:-2], 2.5, True, "nonsense", "cuda:99", MESH)
CHOICES = (*OBJECTS, 3, "nonsense")
SEEDS = (*OBJECTS, "nonsense", None, 1.5, float("nan"))
WEIGHTS = (*OBJECTS, "nonsense", None, float("nan"))
FAMILY = sdm.shapes.Ellipsoid.example()
CUBE = np.ones((4, 4, 4))
MASK = torch.ones(1, 1, 2, 2, 2)
TENSORS = (*OBJECTS, None, 3, "nonsense", MESH, CUBE, torch.ones(2))
POINT_SETS = (*OBJECTS, None, 3, "nonsense", [1, 2], ["a", "b", "c"], MESH)

CALLS: dict[str, tuple[Callable[[Any], Any], tuple[Any, ...]]] = {
    "signed_distance_map mesh": (lambda x: sdm.signed_distance_map(x, 4), MESHES),
    "signed_distance_map grid": (lambda x: sdm.signed_distance_map(MESH, x), GRIDS),
    "signed_distance_map margin": (lambda x: sdm.signed_distance_map(MESH, 4, margin=x), LENGTHS),
    "signed_distance_map device": (lambda x: sdm.signed_distance_map(MESH, 4, device=x), DEVICES),
    "signed_distance_map sign": (lambda x: sdm.signed_distance_map(MESH, 4, sign=x), CHOICES),
    "signed_distance_map orient": (lambda x: sdm.signed_distance_map(MESH, 4, orient=x), CHOICES),
    "signed_distance_map hole_size": (lambda x: sdm.signed_distance_map(MESH, 4, sign="flood", hole_size=x), LENGTHS),
    "signed_distance mesh": (lambda x: sdm.signed_distance(x, POINTS), MESHES),
    "signed_distance points": (lambda x: sdm.signed_distance(MESH, x), POINT_SETS),
    "signed_distances meshes": (lambda x: sdm.signed_distances(x, [POINTS]), (None, 3, object(), "a", MESH, GRID)),
    "signed_distances points": (lambda x: sdm.signed_distances([MESH], x), POINT_SETS),
    "signed_distances max_bytes": (lambda x: sdm.signed_distances([MESH], [POINTS], max_bytes=x), NUMBERS),
    "signed_distance_maps max_bytes": (lambda x: sdm.signed_distance_maps([MESH], 4, max_bytes=x), NUMBERS),
    "narrow_band mesh": (lambda x: sdm.narrow_band(x, 0.2), NO_MESHES),
    "narrow_band spacing": (lambda x: sdm.narrow_band(MESH, spacing=x), (*LENGTHS, 0, ["a"] * 3)),
    "narrow_band half_width": (lambda x: sdm.narrow_band(MESH, 0.2, half_width=x), LENGTHS),
    "narrow_band margin": (lambda x: sdm.narrow_band(MESH, 0.2, margin=x), LENGTHS),
    "inspect_mesh": (sdm.inspect_mesh, MESHES),
    "orient_faces mesh": (sdm.orient_faces, MESHES),
    "orient_faces device": (lambda x: sdm.orient_faces(MESH, x), DEVICES),
    "MeshIndex device": (lambda x: sdm.MeshIndex(MESH, x), DEVICES),
    "watertight offset": (lambda x: sdm.watertight(MESH, 16, offset=x), LENGTHS),
    "euclidean_distance_transform spacing": (
        lambda x: sdm.euclidean_distance_transform(np.ones((2, 2, 2)), x),
        (*LENGTHS, 0, ["a"] * 3),
    ),
    "euclidean_distance_transform surface": (
        lambda x: sdm.euclidean_distance_transform(np.ones((2, 2, 2)), surface=x),
        CHOICES,
    ),
    "euclidean_distance_transform missing": (
        lambda x: sdm.euclidean_distance_transform(np.ones((2, 2, 2)), missing=x),
        (*OBJECTS, "nonsense", float("nan"), torch.zeros(2)),
    ),
    "euclidean_distance_transform classes": (
        lambda x: sdm.euclidean_distance_transform(np.ones((2, 2, 2)), classes=x),
        (*OBJECTS, "nonsense", MESH, [1.5]),
    ),
    "Grid.around margin": (lambda x: sdm.Grid.around(MESH, 4, margin=x), LENGTHS),
    "Grid.around_box": (lambda x: sdm.Grid.around_box(x, np.ones(3), 4), POINT_SETS),
    "Grid.from_affine": (lambda x: sdm.Grid.from_affine(x, (2, 2, 2)), (*POINT_SETS, POINTS)),
    "Grid.points": (GRID.points, (*NUMBERS, 6)),
    "TriangleMesh.to": (MESH.to, DEVICES),
    "SDM.to": (lambda x: field().to(x), (*OBJECTS[:-2], "nonsense", "cuda:99", MESH)),
    "SparseSDM.to": (lambda x: sdm.narrow_band(MESH, 0.2).to(x), DEVICES),
    "SDM.truncate": (lambda x: field().truncate(x), (*LENGTHS, 0)),
    "SDM.occupancy": (lambda x: field().occupancy(x), (*OBJECTS, "nonsense", None, float("nan"))),
    "SDM.to_mesh": (lambda x: field().to_mesh(x), (*OBJECTS, "nonsense", None, 10**400)),
    "SDM.sample": (lambda x: field().sample(POINTS, order=x), (*NUMBERS, 2)),
    "load": (sdm.load, PATHS),
    "load_mesh": (sdm.load_mesh, PATHS),
    "load_band": (sdm.io.load_band, PATHS),
    "mesh_files": (sdm.io.mesh_files, (*PATHS[:-3], "nonsense")),
    "mesh_tree": (sdm.io.mesh_tree, (*PATHS[:-3], "nonsense")),
    "save map": (lambda x: sdm.save(x, "never.npz"), (*OBJECTS, None, 3, "nonsense", MESH)),
    "save path": (lambda x: sdm.save(field(), x), PATHS),
    "save_mesh path": (lambda x: sdm.save_mesh(MESH, x), PATHS),
    "SDMDataset": (sdm.SDMDataset, PATHS),
    "check_target": (sdm.io.check_target, PATHS),
    "write_streamed index": (lambda x: sdm.io.write_streamed(x, GRID, "never.npz"), (*OBJECTS, None, MESH)),
    "sample count": (lambda x: sdm.sampling.sample(MESH, x), (*NUMBERS, 0, 1.5)),
    "sample first": (lambda x: sdm.sampling.sample(MESH, 2, first=x), (*NUMBERS, 1.5)),
    "sample law": (lambda x: sdm.sampling.sample(MESH, 2, law=x), (*OBJECTS, None, "paper")),
    "sample seed": (lambda x: sdm.sampling.sample(MESH, 2, seed=x), SEEDS),
    "surface_points count": (lambda x: sdm.sampling.surface_points(MESH, x), (*NUMBERS, 1.5)),
    "SampleLaw near": (lambda x: sdm.sampling.SampleLaw(near=x), NUMBERS),
    "SampleLaw deviations": (lambda x: sdm.sampling.SampleLaw(deviations=x), (*OBJECTS, 0.1, ["a"], [-1.0])),
    "SampleLaw box": (lambda x: sdm.sampling.SampleLaw(box=x), LENGTHS),
    "SDMStream batch_size": (lambda x: sdm.SDMStream(FAMILY, GRID, x), NUMBERS),
    "SDMStream seed": (lambda x: sdm.SDMStream(FAMILY, GRID, seed=x), SEEDS),
    "SDMStream prefetch": (lambda x: sdm.SDMStream(FAMILY, GRID, prefetch=x), (*NUMBERS, 0)),
    "SDMStream start": (lambda x: sdm.SDMStream(FAMILY, GRID, start=x), NUMBERS),
    "SDMStream stop": (lambda x: sdm.SDMStream(FAMILY, GRID, stop=x), NUMBERS),
    "SDMStream dtype": (lambda x: sdm.SDMStream(FAMILY, GRID, dtype=x), (*OBJECTS, "float32", torch.int32)),
    "SDMStream truncate": (lambda x: sdm.SDMStream(FAMILY, GRID, truncate=x), (*LENGTHS, 0)),
    "Mixture share": (lambda x: sdm.stream.Mixture(share=x), (*LENGTHS, 0, 1)),
    "Table": (sdm.stream.Table, POINT_SETS),
    "TensorGrid": (sdm.stream.TensorGrid, (*NUMBERS, 1)),
    "ValidationSet maker": (lambda x: sdm.stream.ValidationSet(x, 2), (*OBJECTS, None, FAMILY)),
    "ValidationSet count": (lambda x: sdm.stream.ValidationSet(sdm.stream.Maker(FAMILY, GRID), x), (*NUMBERS, 0)),
    "generate count": (lambda x: sdm.dataset.generate(FAMILY, GRID, x, "never"), (*NUMBERS, 0)),
    "generate shard": (lambda x: sdm.dataset.generate(FAMILY, GRID, 2, "never", shard=x), (*NUMBERS, 0)),
    "generate path": (lambda x: sdm.dataset.generate(FAMILY, GRID, 2, x), PATHS),
    "freeze stream": (lambda x: sdm.dataset.freeze(x, 2, "never"), (*OBJECTS, None, FAMILY)),
    "Cuboid sizes": (lambda x: sdm.shapes.Cuboid(sizes=x), (*OBJECTS, 1, [2, 1], ["a", "b"])),
    "Cuboid triangles": (lambda x: sdm.shapes.Cuboid(triangles=x), NUMBERS),
    "Cuboid shift": (lambda x: sdm.shapes.Cuboid(shift=x), LENGTHS),
    "Rhomboid shear": (lambda x: sdm.shapes.Rhomboid(shear=x), LENGTHS),
    "Cochlea triangles": (sdm.shapes.Cochlea, NUMBERS),
    "Cochlea design": (lambda x: sdm.shapes.Cochlea(600, design=x), OBJECTS),
    "Parameter": (lambda x: sdm.shapes.Parameter("a", x, 1.0), (*OBJECTS, "nonsense", None, float("nan"), 2.0)),
    "MeshFolder source": (sdm.shapes.MeshFolder, (*OBJECTS, None, 3, "nonsense", GRID)),
    "MeshFolder scale": (lambda x: sdm.shapes.MeshFolder([MESH], scale=x), (*OBJECTS, None, 1, [2, 1], [1, 2, 3])),
    "MeshFolder warp": (lambda x: sdm.shapes.MeshFolder([MESH], warp=x), LENGTHS),
    "MeshFolder rotation": (lambda x: sdm.shapes.MeshFolder([MESH], rotation=x), LENGTHS),
    "StatisticalShape mean": (lambda x: shape_model(mean=x), POINT_SETS),
    "StatisticalShape faces": (lambda x: shape_model(faces=x), (*POINT_SETS, POINTS)),
    "StatisticalShape limit": (lambda x: shape_model(limit=x), LENGTHS),
    "shapes.grid per_axis": (lambda x: sdm.shapes.grid(x, 2), (*NUMBERS, 1)),
    "shapes.grid width": (lambda x: sdm.shapes.grid(2, x), (*NUMBERS, 0, 10**6)),
    "shapes.uniform seed": (lambda x: sdm.shapes.uniform(x, [0], 2), SEEDS),
    "shapes.uniform index": (lambda x: sdm.shapes.uniform(0, x, 2), (1j, None, 3, "nonsense", [[1, 2]])),
    "shapes.sobol width": (lambda x: sdm.shapes.sobol(0, [0], x), NUMBERS),
    "Family.sample count": (FAMILY.sample, NUMBERS),
    "Family.sample_at sampler": (lambda x: FAMILY.sample_at([0], sampler=x), CHOICES),
    "family_record": (sdm.shapes.family_record, (*OBJECTS, None, "cochlea")),
    "make_family": (sdm.shapes.make_family, (*OBJECTS, None, "nonsense")),
    "dice": (lambda x: sdm.metrics.dice(x, np.ones((2, 2, 2))), (*OBJECTS, None, 3, "nonsense", MESH)),
    "contour_dice width": (lambda x: sdm.metrics.contour_dice(CUBE, CUBE, x), (*NUMBERS, 4)),
    "hausdorff_distance percentile": (lambda x: sdm.metrics.hausdorff_distance(CUBE, CUBE, 1.0, x), (*LENGTHS, 101)),
    "surface_voxels": (sdm.metrics.surface_voxels, (*OBJECTS, None, CUBE, torch.ones(2, 2))),
    "dice_loss": (lambda x: sdm.losses.dice_loss(x, MASK), TENSORS),
    "dice_loss smooth": (lambda x: sdm.losses.dice_loss(MASK, MASK, smooth=x), WEIGHTS),
    "boundary_loss": (lambda x: sdm.losses.boundary_loss(x, MASK), TENSORS),
    "hausdorff_distance_loss": (lambda x: sdm.losses.hausdorff_distance_loss(MASK, x), TENSORS),
    "hausdorff_distance_loss power": (lambda x: sdm.losses.hausdorff_distance_loss(MASK, MASK, power=x), WEIGHTS),
    "clamped_l1_loss delta": (lambda x: sdm.losses.clamped_l1_loss(MASK, MASK, delta=x), (*NUMBERS, 0)),
    "cross_entropy_loss": (lambda x: sdm.losses.cross_entropy_loss(x, MASK), TENSORS),
    "clipped_sdf": (sdm.losses.clipped_sdf, TENSORS[:-1]),
    "clipped_sdf limit": (lambda x: sdm.losses.clipped_sdf(MASK, x), (*NUMBERS, 0)),
    "class_maps": (sdm.losses.class_maps, TENSORS),
    "probability_from_sdf steepness": (lambda x: sdm.losses.probability_from_sdf(MASK, x), WEIGHTS),
    "constant": (sdm.losses.constant, WEIGHTS),
    "linear": (lambda x: sdm.losses.linear(0.0, x, 5), WEIGHTS),
    "stepwise": (lambda x: sdm.losses.stepwise(1.0, x, 5, 0.0), WEIGHTS),
    "sigmoid_rampup": (lambda x: sdm.losses.sigmoid_rampup(1.0, x), (*NUMBERS, 0)),
    "surrogate.exact_map": (sdm.surrogate.exact_map, (*OBJECTS, None, 3, "nonsense", [1.0, 2.0])),
    "surrogate.build": (sdm.surrogate.build, CHOICES),
    "surrogate.load_surrogate source": (sdm.surrogate.load_surrogate, tuple(x for x in PATHS if x is not None)),
    "surrogate.load_surrogate device": (lambda x: sdm.surrogate.load_surrogate(device=x), DEVICES[:-1]),
    "deepsdf.label_surface": (lambda x: sdm.deepsdf.label_surface(x, 1.0), TENSORS),
    "deepsdf.load_code": (sdm.deepsdf.load_code, PATHS),
    "deepsdf.chamfer_distance": (lambda x: sdm.deepsdf.chamfer_distance(x, torch.ones(2, 3)), POINT_SETS),
    "deepsdf.earth_movers_distance": (lambda x: sdm.deepsdf.earth_movers_distance(torch.ones(2, 3), x), POINT_SETS),
    "deepsdf.half_of": (lambda x: sdm.deepsdf.half_of(x, torch.ones(3)), (*POINT_SETS, POINTS)),
    "deepsdf.save_picture": (lambda x: sdm.deepsdf.save_picture(x, "never.png"), TENSORS),
    "deepsdf.Settings width": (lambda x: sdm.deepsdf.Settings(width=x), (*NUMBERS, None, 0, 1.5)),
    "surrogate.Settings steps": (lambda x: sdm.surrogate.Settings(steps=x), (*NUMBERS, None, 0, 1.5)),
    "SDMNN": (sdm.surrogate.SDMNN, (*NUMBERS, None, 0)),
    "PODChebyshev": (sdm.surrogate.PODChebyshev, (*NUMBERS, None, 0)),
    "SDMNNPlus": (sdm.surrogate.SDMNNPlus, (*NUMBERS, None, 0)),
    "segmentation.method_called": (sdm.segmentation.method_called, CHOICES),
    "segmentation.read_cases": (sdm.segmentation.read_cases, (*PATHS[:-3], "nonsense")),
    "segmentation.largest_component": (sdm.segmentation.largest_component, TENSORS),
    "FitOptions blur": (lambda x: sdm.fit.FitOptions(blur=x), LENGTHS),
    "FitOptions fine": (lambda x: sdm.fit.FitOptions(fine=x), LENGTHS),
    "FitOptions components": (lambda x: sdm.fit.FitOptions(components=x), (*OBJECTS, None, 1, [0, 1], ["a", "b"])),
    "ExactBackend": (sdm.fit.ExactBackend, (*OBJECTS, 3, "cochlea")),
    "picture": (lambda x: sdm.viz.picture(x, "never.png"), (*OBJECTS, None, MESH)),
    "picture dpi": (lambda x: sdm.viz.picture(field(), "never.png", dpi=x), (*NUMBERS, 0)),
    "compat.igl points": (lambda x: sdm.compat.igl.signed_distance(x, MESH.vertices, MESH.faces), POINT_SETS),
    "compat.mesh_to_sdf voxels": (lambda x: sdm.compat.mesh_to_sdf.mesh_to_voxels(MESH, x), (*NUMBERS, 0)),
}


def shape_model(**other: Any) -> sdm.shapes.StatisticalShape:
    given: dict[str, Any] = {"mean": MESH.vertices, "modes": np.ones((1, 4, 3)), "deviations": [1.0]}
    return sdm.shapes.StatisticalShape(**{**given, "faces": MESH.faces, **other})


def field() -> sdm.SDM:
    return sdm.SDM(np.ones(GRID.shape), GRID)


@pytest.mark.parametrize("name", CALLS)
def test_nonsense_is_refused_in_one_sentence(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, values = CALLS[name]
    found = {}
    for value in values:
        try:
            call(value)
            found[repr(value)] = "taken"
        except SDMError as error:
            if "\n" in str(error):
                found[repr(value)] = str(error)
        except Exception as error:  # noqa: BLE001
            found[repr(value)] = f"{type(error).__name__}: {error}"
    assert not found
    assert not list(tmp_path.iterdir())


def test_numbers_of_any_library_are_numbers():
    for three in (3, 3.0, np.int64(3), np.float32(3), torch.tensor(3), torch.tensor(3.0)):
        assert (real(three), whole(three, 3), whole(three, 4)) == (3, 3, None)
    assert whole(2**63, 0) is whole(3.5, 0) is whole("3", 0) is None
    assert np.isnan([real("3"), real(None), real(1j), real(10**400)]).all()
