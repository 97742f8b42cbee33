"""Shapes and numbers of parameters of the two networks and their heads."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch
from torch import nn

from sdm.segmentation import METHODS, SegmentationModel
from sdm.segmentation.networks.unet import UNetDecoder, UNetEncoder
from sdm.segmentation.networks.vnet import DEPTHS, VNetDecoder, VNetEncoder


def parameters(*modules: nn.Module, kinds=(nn.Module,)) -> int:
    found = {id(p): p for m in modules for sub in m.modules() if isinstance(sub, kinds) for p in sub.parameters(False)}
    return sum(p.numel() for p in found.values())


def test_the_vnet_has_the_published_size():
    """9.44 million: counted by hand from five levels of 16 to 256 channels."""
    down = [16, 32, 64, 128, 256]
    kernels = 27 * (1 * 16 + sum(d * c * c for d, c in zip(DEPTHS[1:], down[1:], strict=True)))
    kernels += 27 * sum(d * c * c for d, c in zip(DEPTHS[:-1], down[:-1], strict=True))
    kernels += 2 * 8 * sum(a * b for a, b in pairwise(down))
    found = [m.weight.numel() for n in (VNetEncoder(), VNetDecoder()) for m in n.modules() if hasattr(m, "kernel_size")]
    assert sum(found) == kernels == 9_440_432
    assert round(parameters(VNetEncoder(), VNetDecoder()) / 1e6, 2) == 9.45


def test_the_unet_has_the_published_size():
    """Cicek et al. state 19,069,955 for 3 channels in and out; batch normalisation and biases of 2^3 kernels apart."""
    encoder, decoder, last = UNetEncoder(64, inputs=3), UNetDecoder(64), nn.Conv3d(64, 3, 1)
    count = parameters(encoder, decoder, last, kinds=(nn.Conv3d, nn.ConvTranspose3d))
    biases = sum(up.bias.numel() for up in decoder.ups)
    assert count - biases == 19_069_955


@pytest.mark.parametrize("architecture", ["vnet", "unet"])
@pytest.mark.parametrize("name", ["baseline", "head-sdf-l1", "branch-dtm-l2", "pwr", "sdf-product"])
def test_outputs(architecture, name):
    model = SegmentationModel(METHODS[name], architecture, filters=2).eval()
    image = torch.randn(2, 1, 32, 16, 16)
    main, auxiliary = model(image)
    assert main.shape == image.shape
    assert main.dtype == torch.float32
    assert (auxiliary is not None) == (METHODS[name].auxiliary is not None)
    if auxiliary is not None:
        assert auxiliary.shape == image.shape
        low = 0 if METHODS[name].map == "foreground" else -1
        assert auxiliary.min() >= low
        assert auxiliary.max() <= 1
    field = model.field(image)
    inside = main > 0 if METHODS[name].output == "logit" else main < 0
    assert ((field < 0) == inside).all()


def test_a_head_shares_the_decoder_and_a_branch_has_its_own():
    sizes = {
        n: parameters(SegmentationModel(METHODS[n], filters=4)) for n in ("baseline", "head-sdf-l1", "branch-sdf-l1")
    }
    assert sizes["head-sdf-l1"] - sizes["baseline"] == 4 + 1
    assert sizes["branch-sdf-l1"] - sizes["head-sdf-l1"] == parameters(VNetDecoder(4))


@pytest.mark.parametrize("pair", [(VNetEncoder, VNetDecoder), (UNetEncoder, UNetDecoder)])
@pytest.mark.parametrize("skips", [True, False])
def test_a_branch_sees_the_coarsest_level_alone(pair, skips):
    # Some networks of two filters have no unit that is alive, and see nothing at all.
    torch.manual_seed(0)
    encoder, decoder = pair[0](2).eval(), pair[1](2, skips=skips).eval()
    features = encoder(torch.randn(1, 1, 16, 16, 16))
    before = decoder(features)
    changed = [f + 1 for f in features[:-1]] + features[-1:]
    assert torch.equal(before, decoder(changed)) != skips
