"""The exported network and torch agree."""

from __future__ import annotations

import pytest
import torch

from sdm.errors import SDMError
from sdm.shapes import Cochlea
from sdm.surrogate import SDMNNPlus, build, load_surrogate
from sdm.surrogate.infer import runtime
from sdm.surrogate.infer.runtime import BACKENDS, NEEDS, available, runner
from sdm.training.precision import cpu_has_bfloat16

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
    run = runner(model, backend, threads=1, bfloat16=False)
    for count in (1, 3):
        theta = Cochlea().sample(count, device="cpu")
        with torch.no_grad():
            torch.testing.assert_close(run(theta), model(theta), atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("backend", ["openvino", "torch"])
def test_bfloat16_of_the_refinement_is_close(backend):
    for module in NEEDS[backend]:
        pytest.importorskip(module)
    model = load_surrogate()
    run, exact = runner(model, backend, threads=1), runner(model, "torch", bfloat16=False)
    # The batch of one in the middle has networks of its own; what came before it must stay as it was.
    thetas = [Cochlea().sample(count, seed=count, device="cpu") for count in (2, 1, 3)]
    found = [run(theta) for theta in thetas]
    for theta, maps in zip(thetas, found, strict=True):
        error = (maps - exact(theta)).abs()
        assert maps.dtype == torch.float32
        assert float(error.max()) < 0.01
        assert float(error.mean()) < 5e-4
        # Where the processor has bfloat16, it is used.
        assert backend == "openvino" or bool(error.any()) == cpu_has_bfloat16()


@pytest.mark.parametrize("there", [True, False])
def test_torch_goes_before_onnx_runtime_where_it_has_bfloat16(there, monkeypatch):
    monkeypatch.setattr(runtime, "available", lambda: ["onnxruntime", "torch"])
    monkeypatch.setattr(runtime, "cpu_has_bfloat16", lambda: there)
    model = SDMNNPlus(modes=2, channels=2)
    assert runtime._fastest(model, True) == ("torch" if there else "onnxruntime")
    assert runtime._fastest(model, False) == "onnxruntime"


def test_torch_is_always_there_and_others_are_refused_in_a_sentence():
    assert available()[-1] == "torch"
    with pytest.raises(SDMError, match="not installed"):
        runner(SDMNNPlus(modes=2, channels=2), "tensorrt")
