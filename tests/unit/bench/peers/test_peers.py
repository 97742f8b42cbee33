"""Every peer that is installed measures what the oracle measures, and one that is not says so."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import warp as wp

from sdm import Grid
from sdm.bench.common.meshes import load_case
from sdm.bench.peers import all_peers, newton
from sdm.bench.peers.physicsnemo import file_alone
from tests.helpers import oracle

NAMES = [peer.name for peer in all_peers("cpu")]
WITH_POINTS = [peer.name for peer in all_peers("cpu") if peer.points_too]

pytestmark = pytest.mark.filterwarnings("default")  # other libraries' warnings are theirs


@pytest.fixture(autouse=True, scope="module")
def no_gradients():
    """Of Warp's geometry, which compiles for a third of the time without them."""
    wp.get_module("warp.geometry").options["enable_backward"] = False


@pytest.fixture(scope="module")
def asked():
    case = load_case("sphere")
    points = np.random.default_rng(3).uniform(-1.2, 1.2, (300, 3)).astype(np.float32)
    d, _, _ = oracle.distance(case.vertices, case.faces, points)
    w = oracle.winding_number(case.vertices, case.faces, points)
    return case, torch.from_numpy(points), np.where(w > 0.5, -d, d)


def made(name):
    return next(peer for peer in all_peers("cpu") if peer.name == name)


def ready(name, case):
    peer = made(name)
    if (note := peer.missing()) is not None:
        pytest.skip(note)
    peer.build(case)
    return peer


@pytest.mark.parametrize("name", WITH_POINTS)
def test_points(name, asked):
    case, points, expected = asked
    peer = ready(name, case)
    values = peer.signed_distance(points).numpy()
    # point-cloud-utils multiplies by its approximate winding number.
    np.testing.assert_allclose(values, expected, atol=5e-3 if name == "point-cloud-utils" else 2e-6)
    if "distance" in peer.parts:
        np.testing.assert_allclose(peer.unsigned_distance(points).numpy(), np.abs(expected), atol=2e-6)
    if "sign" in peer.parts:
        np.testing.assert_array_equal(peer.inside(points).numpy(), expected < 0)


@pytest.mark.parametrize("name", NAMES)
def test_maps(name, asked):
    case, _, _ = asked
    peer = ready(name, case)
    grid = Grid((-1.1, -1.0, -0.9), (0.4, 0.3, 0.5), (5, 6, 4))
    at = grid.points().numpy().reshape(-1, 3)
    d, _, _ = oracle.distance(case.vertices, case.faces, at)
    expected = np.where(oracle.winding_number(case.vertices, case.faces, at) > 0.5, -d, d).reshape(grid.shape)
    peer.prepare(grid)
    values = peer.signed_distance_map(grid).numpy()
    assert values.shape == grid.shape
    np.testing.assert_allclose(values, expected, atol=5e-3 if name == "point-cloud-utils" else 2e-6)


def test_what_is_not_installed_is_named(monkeypatch):
    peer = made("Open3D")
    monkeypatch.setattr(peer, "module", "no_such_library")
    assert peer.missing() == "Open3D is not installed"
    assert not peer.available()
    if not torch.cuda.is_available():
        assert "no CUDA device" in (all_peers("cuda")[0].missing() or "")


def test_both_trees_of_warp_are_peers_on_a_gpu():
    notes = {peer.name: peer.note for peer in all_peers("cuda")}
    assert notes["Warp winding number"] == "LBVH, leaf 4"
    assert notes["Warp winding number, SAH"] == "SAH, leaf 4"
    assert "Warp winding number, SAH" not in NAMES


def test_physicsnemo_is_asked_for_winding_numbers(asked, monkeypatch):
    case, points, expected = asked
    calls = []

    def signed_distance_field(vertices, faces, at, *, use_sign_winding_number):
        calls.append((vertices, faces, use_sign_winding_number))
        return torch.from_numpy(expected).float(), at, None

    library = SimpleNamespace(signed_distance_field=signed_distance_field)
    monkeypatch.setitem(sys.modules, "physicsnemo", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "physicsnemo.nn", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "physicsnemo.nn.functional", library)
    peer = made("PhysicsNeMo")
    peer.build(case)
    assert torch.equal(peer.signed_distance(points), torch.from_numpy(expected).float())
    ((vertices, faces, winding),) = calls
    assert winding
    assert vertices.shape == case.vertices.shape
    assert (faces.dtype, faces.shape) == (torch.int32, case.faces.shape)


def test_physicsnemo_runs_without_what_its_package_needs(asked, monkeypatch, tmp_path):
    """Its package does not import, and the file of its function does."""
    package = tmp_path / "physicsnemo"
    geometry = package / "nn" / "functional" / "geometry"
    geometry.mkdir(parents=True)
    (package / "core").mkdir()
    (package / "core" / "spec.py").write_text("SIGN = -1.0\n")
    for folder in (package, package / "core", package / "nn", package / "nn" / "functional", geometry):
        (folder / "__init__.py").write_text("import a_package_that_is_not_there\n")
    (geometry / "sdf.py").write_text(
        "from physicsnemo.core.spec import SIGN\n"
        "def signed_distance_field(vertices, faces, at, *, use_sign_winding_number):\n"
        "    return SIGN * at[:, 0], at, None\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    file_alone.cache_clear()
    before = set(sys.modules)
    try:
        peer = made("PhysicsNeMo")
        case, points, _ = asked
        assert peer.missing() is None
        peer.build(case)
        assert torch.equal(peer.signed_distance(points), -points[:, 0])
        assert not {"physicsnemo", "physicsnemo.nn"} & set(sys.modules)
        (geometry / "sdf.py").unlink()
        file_alone.cache_clear()
        sys.modules.pop("physicsnemo.nn.functional.geometry.sdf")
        assert "nor does its function alone" in (peer.missing() or "")
    finally:
        file_alone.cache_clear()
        for name in set(sys.modules) - before:
            if name.startswith("physicsnemo"):
                del sys.modules[name]


def test_meshlib_takes_the_winding_numbers_of_a_gpu(asked, monkeypatch):
    case, _, _ = asked
    volumes = []
    mesh = SimpleNamespace(getAABBTree=lambda: None)
    params = SimpleNamespace(vol=SimpleNamespace(), dist=SimpleNamespace())
    library = SimpleNamespace(
        MeshToDistanceVolumeParams=lambda: params,
        Vector3f=lambda *v: v,
        Vector3i=lambda *v: v,
        MeshPart=lambda one: one,
        SignDetectionMode=SimpleNamespace(HoleWindingRule="rule"),
        meshToDistanceVolume=lambda part, given: volumes.append((part, given)),
    )
    arrays = SimpleNamespace(
        meshFromFacesVerts=lambda faces, vertices: mesh, getNumpy3Darray=lambda volume: np.zeros((2, 2, 2))
    )
    cuda = SimpleNamespace(
        FastWindingNumber=lambda one: ("on a GPU", one),
        PointsToMeshProjector=lambda: SimpleNamespace(updateMeshData=lambda one: None),
    )
    for name, module in {"mrmeshpy": library, "mrmeshnumpy": arrays, "mrcudapy": cuda}.items():
        monkeypatch.setitem(sys.modules, f"meshlib.{name}", module)
    monkeypatch.setitem(sys.modules, "meshlib", SimpleNamespace())
    peer = next(peer for peer in all_peers("cuda") if peer.name == "MeshLib, CUDA")
    peer.build(case)
    peer.signed_distance_map(Grid((0, 0, 0), (1, 1, 1), (2, 2, 2)))
    assert volumes == [(mesh, params)]
    assert params.fwn == ("on a GPU", mesh)
    assert params.vol.origin == (-0.5, -0.5, -0.5)


def test_meshlib_at_points(asked, monkeypatch):
    """The searches of its CUDA module, which its other one has for the CPU."""
    pytest.importorskip("meshlib.mrmeshpy")
    case, points, expected = asked
    peer = next(peer for peer in all_peers("cuda") if peer.name == "MeshLib, CUDA")
    monkeypatch.setattr(peer, "module", "meshlib.mrmeshpy")
    monkeypatch.setattr(peer, "device", "cpu")
    assert peer.missing() is None
    peer.build(case)
    np.testing.assert_allclose(peer.signed_distance(points).numpy(), expected, atol=2e-6)
    np.testing.assert_allclose(peer.unsigned_distance(points).numpy(), np.abs(expected), atol=2e-6)
    np.testing.assert_array_equal(peer.inside(points).numpy(), expected < 0)
    assert len(peer.signed_distance(points[:0])) == 0


def test_meshlib_that_does_not_run_says_so(monkeypatch):
    peer = next(peer for peer in all_peers("cuda") if peer.name == "MeshLib, CUDA")
    monkeypatch.setattr(peer, "device", "cpu")

    def build(case):
        raise RuntimeError("no kernel image")

    monkeypatch.setattr(peer, "module", "json")
    monkeypatch.setattr(peer, "build", build)
    assert peer.missing() == "MeshLib, CUDA is installed but does not run on cpu: no kernel image"


def test_newton_says_why_it_is_left_out(monkeypatch):
    assert newton.missing("cpu") == "Newton is left out: it makes its fields on a GPU alone"
    monkeypatch.setitem(sys.modules, "newton", None)
    assert "cannot be imported" in (newton.missing("cuda") or "")
