"""Several networks together: the mean of what they say, where it has a meaning."""

from __future__ import annotations

import pytest
import torch

from sdm.errors import SDMError
from sdm.segmentation import (
    METHODS,
    SegmentationModel,
    Settings,
    TrainedModel,
    check_ensemble,
    largest_component,
    predict,
    predict_ensemble,
    validate,
    validate_ensemble,
)
from tests.helpers.segmentation_cases import case

CUBE = (16, 16, 16)


def network(seed: int = 0, method: str = "baseline", spacing=(0.8, 0.8, 1.25), **changes) -> TrainedModel:
    """Untrained, but of two minds: some of an image is foreground to it."""
    settings = Settings(method=method, architecture="unet", patch=CUBE, filters=2, seed=seed)
    settings = Settings(**{**settings.record(), "patch": CUBE, **changes})
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        model = SegmentationModel(METHODS[method], "unet", filters=2, position=settings.position)
        shown = torch.randn(1, 4 if settings.position else 1, *CUBE)
    model.eval()
    with torch.no_grad():
        model.main.weight.mul_(20.0)
        assert model.main.bias is not None
        model.main.bias.sub_(model.main(model.decoded(shown)[0]).median())
    return TrainedModel(model, settings, spacing)


def alone(trained: TrainedModel, mirrors: str = "") -> torch.Tensor:
    return predict(trained.model, case().image, trained.settings.patch, mirrors=mirrors).field


# Made when a test wants them: networks take longer than all that is collected here.
MIXTURES = {
    "seeds": lambda: [network(0), network(1), network(2)],
    "methods": lambda: [network(0), network(1, "head-sdf-l1"), network(2, "boundary")],
    "positions": lambda: [network(0), network(1, position=True)],
    "patches": lambda: [network(0), network(1, patch=(32, 16, 8))],
    "distances": lambda: [network(0, "pwr"), network(1, "pwr"), network(2, "pwr", position=True)],
    "normalised distances": lambda: [network(0, "sdf-product"), network(1, "sdf-product")],
}


@pytest.mark.parametrize("name", MIXTURES)
def test_the_mean_of_what_networks_say(name):
    models = MIXTURES[name]()
    found = predict_ensemble(models, case().image, largest=False)
    expected = torch.stack([alone(trained).double() for trained in models]).mean(0)
    torch.testing.assert_close(found.field.double(), expected, atol=1e-6, rtol=1e-6)
    assert torch.equal(found.label, found.field < 0)
    assert 0 < found.label.float().mean() < 1
    assert torch.equal(predict_ensemble(models, case().image).label, largest_component(found.label))


@pytest.mark.parametrize("name", MIXTURES)
def test_their_order_does_not_matter(name):
    models = MIXTURES[name]()
    one, other = (predict_ensemble(order, case().image).field for order in (models, models[::-1]))
    torch.testing.assert_close(one, other, atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize("method", ["baseline", "pwr"])
@pytest.mark.parametrize("mirrors", ["", "x"])
def test_one_alone_says_the_same_bits(method, mirrors):
    trained = network(3, method, mirrors=mirrors)
    found = predict_ensemble([trained], case().image, mirrors=True, stride=(8, 16, 5))
    same = predict(trained.model, case().image, CUBE, mirrors=mirrors, stride=(8, 16, 5))
    assert torch.equal(found.field, same.field)
    assert torch.equal(found.label, same.label)


def test_each_network_is_shown_the_mirror_images_that_it_knows():
    models = [network(0, mirrors="x"), network(1, mirrors="")]
    found = predict_ensemble(models, case().image, mirrors=True).field
    torch.testing.assert_close(found, (alone(models[0], "x") + alone(models[1])) / 2)
    assert not torch.allclose(found, (alone(models[0]) + alone(models[1])) / 2)


def test_windows_can_be_the_same_for_all():
    models = [network(0), network(1, patch=(32, 16, 8))]
    found = predict_ensemble(models, case().image, window=CUBE).field
    expected = sum(predict(trained.model, case().image, CUBE).field for trained in models) / 2
    torch.testing.assert_close(found, expected)


REFUSED = {
    "a probability and network 2 a clipped signed distance of cases, which have no mean": lambda: [
        network(),
        network(1, "pwr"),
    ],
    "a clipped signed distance of cases and network 2 a normalized": lambda: [
        network(0, "pwr"),
        network(1, "sdf-product"),
    ],
    "distance of cases and network 3 a normalized signed distance of patches": lambda: [
        network(0, "sdf-product"),
        network(1, "sdf-product"),
        network(2, "sdf-product", targets="patch"),
    ],
    "voxels of 0.8 x 0.8 x 1.25 mm and network 2 on those of 1 x 1 x 1 mm": lambda: [
        network(),
        network(spacing=(1, 1, 1)),
    ],
    "give at least one": list,
}


@pytest.mark.parametrize("said", REFUSED)
def test_networks_that_have_no_mean(said):
    with pytest.raises(SDMError, match=said):
        predict_ensemble(REFUSED[said](), case().image)


def test_refusals_name_the_files():
    with pytest.raises(SDMError, match=r"^a\.pt says a probability and b\.pt a clipped"):
        check_ensemble([network(), network(1, "pwr")], ["a.pt", "b.pt"])


def test_probabilities_do_not_depend_on_the_targets():
    check_ensemble([network(0, "head-sdf-l1"), network(1, "head-sdf-l1", targets="patch", spacing=(0.81, 0.8, 1.25))])


def test_scores_are_those_of_the_mean():
    one, other = network(0), network(1)
    (alone,) = validate_ensemble([one], [case()])
    (same,) = validate(one.model, [case()], CUBE)
    assert alone == same
    (together,) = validate_ensemble([one, other], [case()])
    assert together != same
    with pytest.raises(ValueError, match="case0 has no label"):
        list(validate_ensemble([one], [case(label=None)]))
