"""torch's default type and device are the caller's: no network, and nothing that one says, depends on them."""

from __future__ import annotations

import pytest
import torch

from sdm.core.demo_mesh import demo_mesh
from sdm.deepsdf import DeepSDF, decode_mesh, encode_meshes, encode_scan, local, render
from sdm.deepsdf import train as train_deepsdf
from sdm.deepsdf.samples import ShapeSet
from sdm.segmentation import Patches, Settings, predict, train
from tests.helpers.segmentation_cases import case


@pytest.fixture(params=["float64", "meta"])
def same(request):
    """The same result with another default."""

    def check(make) -> None:
        expected = make()
        if request.param == "float64":
            torch.set_default_dtype(torch.float64)
        else:
            torch.set_default_device("meta")
        found = make()
        for one, other in zip(expected, found, strict=True):
            assert (one.dtype, one.device) == (other.dtype, other.device)
            assert torch.equal(one, other)

    yield check
    torch.set_default_dtype(torch.float32)
    torch.set_default_device(None)


@pytest.mark.parametrize(
    "changes",
    [
        {"augment": "strong", "position": True, "coarsen": 2},
        {"augment": "scanner", "method": "head-sdf-l1", "average": 0.5},
        {"augment": "published", "method": "pwr"},
    ],
)
def test_segmentation(changes, same):
    settings = Settings(architecture="unet", patch=(16, 16, 16), filters=4, steps=2, batch=2, **changes)

    def make():
        cases = [case(0), case(1)]
        model = train(Patches.of_settings(cases, settings, "cpu"), settings).model
        return [*model.state_dict().values(), predict(model, cases[0].image, settings.patch).field]

    same(make)


def test_deepsdf(same, tmp_path):
    mesh = demo_mesh(rings=41, segments=16, cap_rings=3)
    settings = local(epochs=2, points=64, width=16)

    def make():
        shapes = ShapeSet([mesh] * 2, "cpu")
        path = train_deepsdf(shapes, settings, tmp_path, names=shapes.names, spheres=shapes.spheres, device="cpu")
        return [DeepSDF.load(path, "cpu").codes]

    same(make)


def test_what_a_deepsdf_says(same):
    mesh = demo_mesh(rings=41, segments=16, cap_rings=3)

    def make():
        model = DeepSDF.load("cochlea", "cpu")
        code = model.codes[0]
        whole, part = (
            encode_meshes(model, [mesh], steps=2, points=100)[0].code,
            encode_scan(model, mesh.vertices, steps=2).code,
        )
        told = [model.signed_distance(mesh.vertices, code), model.normals(mesh.vertices[:3], code)]
        return [whole, part, *told, decode_mesh(model, code, resolution=16).vertices, render(model, code, size=8)]

    same(make)
