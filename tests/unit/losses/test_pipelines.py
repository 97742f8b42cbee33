"""Transforms for MONAI and TorchIO, and PyVista's accessor, where these are installed."""

from __future__ import annotations

import sys
from importlib import import_module

import numpy as np
import pytest
import torch

import sdm
from sdm.losses import class_maps
from tests.unit.losses.test_class_maps import LABELS, SPACING

AFFINE = np.diag([-1.0, 0.5, 2.0, 1.0])
AFFINE[:3, 3] = 4, -5, 6


def test_monai():
    data = pytest.importorskip("monai.data", reason="needs MONAI, an extra")
    from monai.transforms import Compose, Flipd

    from sdm.monai import SignedDistanceMap, SignedDistanceMapd

    label = data.MetaTensor(LABELS.clone(), affine=torch.from_numpy(AFFINE))
    wanted = class_maps(LABELS, SPACING, classes=[1, 3])
    found = SignedDistanceMap([1, 3])(label)
    assert isinstance(found, data.MetaTensor)
    assert torch.equal(found.as_tensor(), wanted)
    np.testing.assert_array_equal(found.affine, AFFINE)
    made = Compose([Flipd("label", 0), SignedDistanceMapd("label", [1, 3], truncate=2.0)])({"label": label})
    assert set(made) == {"label", "label_sdm"}
    # After a flip the map is in the label's new space.
    torch.testing.assert_close(made["label_sdm"].affine, made["label"].affine)
    assert torch.equal(made["label_sdm"].as_tensor(), wanted.flip(1).clamp(-2, 2))
    np.testing.assert_array_equal(SignedDistanceMap([1, 3], spacing=SPACING)(LABELS.numpy()), wanted)
    assert type(SignedDistanceMap([1, 3])(LABELS)) is torch.Tensor
    replaced = SignedDistanceMapd(["label", "none"], postfix=None, allow_missing_keys=True)({"label": label})
    assert set(replaced) == {"label"}
    assert replaced["label"].shape == (1, 12, 10, 9)


def test_torchio():
    tio = pytest.importorskip("torchio", reason="needs TorchIO, an extra")
    from sdm.torchio import SignedDistanceMap

    subject = tio.Subject(
        ct=tio.ScalarImage(tensor=torch.rand(1, 12, 10, 9), affine=AFFINE),
        label=tio.LabelMap(tensor=LABELS, affine=AFFINE),
        other=tio.LabelMap(tensor=LABELS, affine=AFFINE),
    )
    found = SignedDistanceMap([1, 3], exclude=["other"])(subject)
    assert set(found) == {"ct", "label", "other", "label_sdm"}
    torch.testing.assert_close(found["label_sdm"].data, class_maps(LABELS, SPACING, classes=[1, 3]))
    np.testing.assert_array_equal(found["label_sdm"].affine, AFFINE)
    assert isinstance(found["label_sdm"], tio.ScalarImage)
    assert "label_sdm" not in subject


def test_random_spatial_transforms_of_monai():
    """The maps are those of the turned label, in its space, which a turned and an LPS affine matrix tell."""
    data = pytest.importorskip("monai.data", reason="needs MONAI, an extra")
    from monai.transforms import Compose, Orientationd, RandAffined, Spacingd

    from sdm.monai import SignedDistanceMapd

    turned = np.array([[0.0, -2.0, 0, 7], [1.0, 0, 0, -3], [0, 0, 1.5, 2], [0, 0, 0, 1]])
    label = data.MetaTensor(LABELS.clone(), affine=torch.from_numpy(turned))
    random = RandAffined("label", prob=1.0, rotate_range=(0.4,) * 3, scale_range=(0.2,) * 3, mode="nearest")
    steps = [
        Orientationd("label", axcodes="LPS", labels=(("L", "R"), ("P", "A"), ("I", "S"))),
        Spacingd("label", (1.0, 0.8, 1.2), mode="nearest"),
        random,
        SignedDistanceMapd("label", [1, 3]),
    ]
    pipeline = Compose(steps)
    pipeline.set_random_state(3)
    made = pipeline({"label": label})
    np.testing.assert_allclose(made["label_sdm"].affine, made["label"].affine)
    assert not np.allclose(made["label"].affine, turned)
    spacing = [float(size) for size in made["label"].pixdim]
    wanted = class_maps(made["label"].as_tensor(), spacing, classes=[1, 3])
    assert torch.equal(made["label_sdm"].as_tensor(), wanted)
    assert (wanted < 0).any()


def test_random_spatial_transforms_of_torchio():
    tio = pytest.importorskip("torchio", reason="needs TorchIO, an extra")
    from sdm.torchio import SignedDistanceMap

    torch.manual_seed(0)
    steps = [tio.RandomAffine(scales=0.2, degrees=20), tio.RandomFlip((0, 1)), tio.ToCanonical(), tio.Resample(1.3)]
    subject = tio.Subject(label=tio.LabelMap(tensor=LABELS, affine=AFFINE))
    made = tio.Compose([*steps, SignedDistanceMap([1, 3])])(subject)
    wanted = class_maps(made["label"].data, [float(size) for size in made["label"].spacing], classes=[1, 3])
    assert torch.equal(made["label_sdm"].data, wanted)
    np.testing.assert_array_equal(made["label_sdm"].affine, made["label"].affine)
    assert (wanted < 0).any()


def test_pyvista():
    pyvista = pytest.importorskip("pyvista", reason="needs PyVista, an extra")
    from sdm.pyvista import SurfaceAccessor

    ball = pyvista.Icosphere(radius=1.0, nsub=2)
    accessor = SurfaceAccessor(ball)
    image = accessor.signed_distance_map(8)
    wanted = sdm.signed_distance_map(ball, 8).values.permute(2, 1, 0).reshape(-1)
    np.testing.assert_allclose(image["implicit_distance"], wanted.cpu(), atol=1e-6)
    assert accessor._index() is accessor._index()
    before = accessor.signed_distance([[0.0, 0, 0]])
    ball.points *= 2
    np.testing.assert_allclose(accessor.signed_distance([[0.0, 0, 0]]), 2 * before, rtol=1e-5)
    assert accessor.inspect().closed
    if hasattr(pyvista, "register_dataset_accessor"):
        assert ball.sdm.signed_distance(ball).shape == (ball.n_points,)


@pytest.mark.parametrize("name", ["monai", "torchio", "pyvista"])
def test_a_library_that_is_not_there_is_named(name, monkeypatch):
    monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, f"sdm.{name}", raising=False)
    for module in [module for module in sys.modules if module.startswith(f"{name}.")]:
        monkeypatch.delitem(sys.modules, module)
    with pytest.raises(sdm.SDMError, match=f"this needs {name}, which cannot be imported"):
        import_module(f"sdm.{name}")
