"""The exported network and torch agree."""

from __future__ import annotations

import pytest
import torch

from sdm.errors import SDMError
from sdm.shapes import Cochlea
from sdm.surrogate import SDMNNPlus, build
from sdm.surrogate.runtime import BACKENDS, NEEDS, available, runner

# The exporter warns of its own parts, and of libraries that it does not need here.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::UserWarning")


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", ["sdmnn-plus", "sdmnn"])
def test_every_backend_gives_torchs_maps(name, backend):
    for module in NEEDS[backend]:
        pytest.importorskip(module)
    torch.manual_seed(0)
    model = build(name, channels=4, **({"modes": 5} if name == "sdmnn-plus" else {})).eval()
    if isinstance(model, SDMNNPlus):
        torch.nn.init.normal_(model.last.weight, std=0.1)
    run = runner(model, backend, threads=1)
    for count in (1, 3):
        theta = Cochlea().sample(count, device="cpu")
        with torch.no_grad():
            torch.testing.assert_close(run(theta), model(theta), atol=1e-4, rtol=1e-4)


def test_torch_is_always_there_and_others_are_refused_in_a_sentence():
    assert available()[-1] == "torch"
    with pytest.raises(SDMError, match="not installed"):
        runner(SDMNNPlus(modes=2, channels=2), "tensorrt")
