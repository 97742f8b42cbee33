"""Scenes that change by themselves, and those of learned shapes."""

from __future__ import annotations

import time

import numpy as np
import pytest
import torch

import sdm
from sdm.deepsdf import DeepSDF, decode_mesh
from sdm.errors import SDMError
from sdm.explore.codes_scene import BETWEEN, FIRST, LAST, CodesScene
from sdm.explore.controls import Moving, start_values
from sdm.explore.cutting_plane import on_plane
from sdm.explore.family_scene import EXACT, METHOD, FamilyScene
from sdm.explore.fit_scene import FOLLOW, STEP, FitScene
from sdm.explore.scene_of import scene_of
from sdm.explore.stream_scene import PACE, RUN, StreamScene
from sdm.shapes import family_record, make_family
from sdm.surrogate.families.family_file import save_family_surrogate
from sdm.surrogate.families.low_rank import LowRankSurrogate

CPU = torch.device("cpu")


def test_a_stream_is_shown_sample_by_sample():
    family = make_family("ellipsoid")
    scene = StreamScene(family, 12, CPU, seed=5, batch_size=2)
    values = start_values(scene)
    assert isinstance(scene, Moving)
    assert scene.pause(values | {PACE: 4.0}) == 0.25
    assert scene.pause(values | {RUN: False}) is None
    batches = iter(sdm.SDMStream(family, family.grid(12), batch_size=3, seed=5, device="cpu"))
    wanted = next(batches)
    for number in range(3):
        shown = scene.show(values)
        assert shown.note.startswith(f"sample {number}:")
        assert torch.equal(shown.field.values, wanted.sdm[number, 0])
        assert scene.step(values)
    scene.close()


@pytest.fixture(scope="module")
def codes() -> CodesScene:
    return scene_of("deepsdf", resolution=20, device=CPU)[0]


def test_the_ends_are_the_shapes_of_the_training(codes):
    model: DeepSDF = codes.model
    for share, number in ((0.0, 3), (1.0, 7)):
        shown = codes.show({FIRST: 3, LAST: 7, BETWEEN: share})
        wanted = decode_mesh(model, model.codes[number], sphere=model.spheres[number], resolution=20)
        np.testing.assert_allclose(shown.vertices, wanted.vertices.numpy(), atol=1e-5)
    middle = codes.show({FIRST: 3, LAST: 7, BETWEEN: 0.5})
    assert middle.vertices.shape != shown.vertices.shape or not np.allclose(middle.vertices, shown.vertices)


def test_a_plane_of_codes_has_the_learned_distances(codes):
    shown = codes.show({FIRST: 0, LAST: 1, BETWEEN: 0.0})
    whole = codes.model.signed_distance_map(shown.field.grid, codes.model.codes[0], codes.model.spheres[0])
    for axis in range(3):
        np.testing.assert_allclose(on_plane(shown.field, axis, 6.0), on_plane(whole, axis, 6.0), atol=2e-5)


def test_a_plane_of_the_exact_engine_is_that_of_its_map():
    family = make_family("cuboid")
    scene = FamilyScene(family, 9, CPU)
    shown = scene.show(start_values(scene))
    whole = sdm.signed_distance_map(family.mesh(scene.theta(start_values(scene))), scene.grid, device="cpu")
    for axis in range(3):
        np.testing.assert_allclose(on_plane(shown.field, axis, 5.0), on_plane(whole, axis, 5.0), atol=1e-6)


def test_a_surrogate_of_another_family(tmp_path):
    family = make_family("ellipsoid")
    low, high = ([getattr(p, end) for p in family.parameters] for end in ("low", "high"))
    grid = family.grid(12)
    model = LowRankSurrogate(low, high, grid.shape, modes=1, degree=0, hidden=0)
    middle = family.mesh([(a + b) / 2 for a, b in zip(low, high, strict=True)])
    model.mean.copy_(sdm.signed_distance_map(middle, grid, device="cpu").values.flatten())
    save_family_surrogate(model, grid, family_record(family), tmp_path)
    scene, _ = scene_of("ellipsoid", resolution=12, device=CPU, surrogate=tmp_path)
    values = start_values(scene)
    assert scene.show(values).note.startswith("surrogate")
    assert scene.show(values | {METHOD: EXACT}).note.startswith(EXACT)
    with pytest.raises(SDMError, match="another family"):
        scene_of("cuboid", resolution=12, device=CPU, surrogate=tmp_path)
    with pytest.raises(SDMError, match="is no folder"):
        scene_of("cuboid", resolution=12, device=CPU, surrogate=tmp_path / "surrogate.json")
    with pytest.raises(SDMError, match="is none"):
        scene_of("mesh.ply", resolution=12, device=CPU, surrogate=tmp_path)


@pytest.fixture(scope="module")
def cochlea():
    return make_family("cochlea", triangles=1000)


def image_of(family, *, noise_alone: bool = False) -> sdm.SDM:
    """A bright shape in noise, or noise alone."""
    grid = sdm.Grid((-6.2, -5.7, -4.2), (0.6,) * 3, (21, 20, 15))
    noise = torch.randn(grid.shape, generator=torch.Generator("cpu").manual_seed(0))
    if noise_alone:
        return sdm.SDM(noise, grid)
    field = sdm.signed_distance_map(family.mesh([3.5, 0.6, 0.15, 0.0]), grid, device="cpu")
    return sdm.SDM(torch.clamp(0.5 - field.values / grid.spacing[0], 0, 1) * 100 + noise, grid)


def wait_for_the_fit(scene: FitScene, values: dict) -> None:
    end = time.monotonic() + 60
    while scene.pause(values) is not None:
        scene.step(values)
        assert time.monotonic() < end
        time.sleep(0.01)


def test_the_steps_of_a_fit(cochlea):
    scene = FitScene("image", image_of(cochlea), cochlea, CPU)
    values = start_values(scene)
    first = scene.show(values)
    assert first.grey
    wait_for_the_fit(scene, values)
    assert scene.steps
    # The search for a place to begin has steps in a coarse image.
    assert not [step for step in scene.steps if step.name.startswith("start")]
    assert scene.result is not None, scene.problem
    last = scene.show(values)
    assert f"step {len(scene.steps)} of {len(scene.steps)}" in last.note
    assert "90 % within" in last.note
    # The outline is where the surface is, to the image's voxel.
    voxel = max(last.field.grid.spacing)
    inside = (last.outline.values < 0).nonzero()
    for axis in range(3):
        places = last.field.grid.points()[tuple(inside.T)][:, axis]
        assert abs(float(places.max()) - last.vertices[:, axis].max()) < 1.5 * voxel
    earlier = scene.show(values | {FOLLOW: False, STEP: 1})
    assert "step 1 of" in earlier.note
    scene.close()


def test_a_fit_without_a_shape_says_so(cochlea):
    scene = FitScene("noise", image_of(cochlea, noise_alone=True), cochlea, CPU)
    values = start_values(scene)
    scene.show(values)
    wait_for_the_fit(scene, values)
    assert "the fit gives no answer" in scene.show(values).note
    scene.close()


def test_a_page_that_is_closed_ends_its_fit(cochlea):
    scene = FitScene("image", image_of(cochlea), cochlea, CPU)
    scene.close()
    scene.show(start_values(scene))
    scene.close()
    assert scene.result is None
    assert not scene.problem
    assert not scene.steps
