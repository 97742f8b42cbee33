from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.core.demo_mesh import demo_mesh
from sdm.errors import SDMError
from sdm.explore.controls import start_values
from sdm.explore.family_scene import ERROR, EXACT, METHOD, FamilyScene
from sdm.explore.map_scene import LEVEL, SAMPLE, MapScene
from sdm.explore.mesh_scene import BY_FLOOD, BY_NONE, QUANTITY, SURFACE, WINDING, MeshScene
from sdm.explore.scene_of import scene_of
from sdm.shapes import make_family

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def ball() -> sdm.TriangleMesh:
    return demo_mesh(rings=21, segments=12)


@pytest.fixture(scope="module")
def cochlea():
    return scene_of("cochlea", resolution=24, device=CPU)


def test_a_slider_moves_the_surface(cochlea):
    scene, unit = cochlea
    values = start_values(scene)
    first = scene.show(values)
    wider = scene.show(values | {"a [mm]": 4.5})
    assert unit == "mm"
    assert np.ptp(wider.vertices[:, 0]) > 1.1 * np.ptp(first.vertices[:, 0])
    assert first.faces.max() < len(first.vertices)
    volume = [float(shown.note.split("volume ")[1].split()[0]) for shown in (first, wider)]
    assert volume[1] > volume[0] > 0


def test_the_surrogate_and_the_exact_engine_show_nearly_one_surface(cochlea):
    scene, _ = cochlea
    values = start_values(scene)
    guess, exact = scene.show(values), scene.show(values | {METHOD: EXACT})
    assert guess.note.startswith("surrogate")
    assert exact.note.startswith(EXACT)
    # To one voxel of the coarse grid on which the exact engine measures here.
    voxel = max(scene.grid.spacing)
    for end in (np.min, np.max):
        np.testing.assert_allclose(end(guess.vertices, axis=0), end(exact.vertices, axis=0), atol=voxel)


def test_the_error_is_coloured_on_the_exact_surface(cochlea):
    scene, _ = cochlea
    values = start_values(scene)
    shown = scene.show(values | {ERROR: True})
    mesh = scene.family.mesh(scene.theta(values))
    assert torch.equal(torch.from_numpy(shown.vertices), mesh.vertices)
    assert shown.colours.shape == shown.vertices.shape
    error = scene.predictor.predict(scene.theta(values)).sample(mesh.vertices).numpy()
    red, blue = shown.colours[error.argmin()].astype(int), shown.colours[error.argmax()].astype(int)
    assert red[0] - red[2] > blue[0] - blue[2]


def test_sliders_of_every_family_reach_its_whole_box():
    family = make_family("cuboid")
    scene = FamilyScene(family, 16, CPU)
    high = scene.theta({control.label: control.high for control in scene.controls})
    assert torch.allclose(high, torch.tensor([p.high for p in family.parameters], device="cpu"), rtol=6e-3)
    family.check(high)
    family.check(scene.theta({control.label: -1e9 for control in scene.controls}))


def test_a_map_by_its_level(ball):
    field = sdm.signed_distance_map(ball, resolution=20, device="cpu")
    scene = MapScene("map", lambda number: field)
    at = [scene.show({LEVEL: level}) for level in (0.0, 0.2)]
    assert np.ptp(at[1].vertices[:, 0]) > np.ptp(at[0].vertices[:, 0]) + 0.1
    assert len(scene.show({LEVEL: 1e6}).faces) == 0


def test_maps_by_number():
    grid = sdm.Grid((0, 0, 0), (1, 1, 1), (3, 3, 3))
    fields = [sdm.SDM(np.linspace(-1, n + 1, 27, dtype=np.float32).reshape(3, 3, 3), grid) for n in range(3)]
    scene = MapScene("maps", lambda number: fields[number], count=3)
    assert scene.show({SAMPLE: 2, LEVEL: 0.0}).field is fields[2]
    with pytest.raises(SDMError, match="same value"):
        MapScene("flat", lambda number: fields[0].with_values(torch.zeros(3, 3, 3, device="cpu")))


def test_an_open_mesh_by_each_sign():
    whole = demo_mesh(rings=21, segments=12)
    mesh = sdm.TriangleMesh(whole.vertices, whole.faces[8:], "open")
    scene = MeshScene(mesh, 20, CPU)
    values = start_values(scene)
    by_winding = scene.show(values)
    assert "open" in by_winding.note
    by_flood = scene.show(values | {QUANTITY: BY_FLOOD})
    assert "differ" in by_flood.note
    assert scene.show(values | {QUANTITY: BY_NONE}).field.inside_voxels == 0
    number = scene.show(values | {QUANTITY: WINDING, SURFACE: True})
    assert number.centre == 0.5
    inside = number.field.values > 0.5
    assert int((inside != (by_winding.field.values < 0)).sum()) <= 2
    assert len(number.faces) > 0


def test_files(tmp_path, ball):
    ball.save(tmp_path / "ball.ply")
    band = sdm.narrow_band(ball, 0.4, half_width=2.0, device="cpu")
    band.save(tmp_path / "band.npz")
    sdm.signed_distance_map(ball, resolution=12, device="cpu").save(tmp_path / "map.nii.gz")
    for name, kind in (("ball.ply", MeshScene), ("band.npz", MapScene), ("map.nii.gz", MapScene)):
        scene, _ = scene_of(str(tmp_path / name), resolution=12, device=CPU)
        assert isinstance(scene, kind)
        assert len(scene.show(start_values(scene)).faces) > 0
    with pytest.raises(SDMError, match="nothing"):
        scene_of(str(tmp_path / "nothing"), resolution=12, device=CPU)
