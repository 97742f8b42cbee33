"""One surrogate, several ways to run it on a CPU."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from sdm.errors import SDMError
from sdm.surrogate.onnx import export_onnx

# Fastest first, as `python -m bench.surrogate --parts timing` measures; the first that is installed is the default.
BACKENDS = ("openvino", "onnxruntime", "torch")
NEEDS = {"openvino": ("openvino", "onnxscript"), "onnxruntime": ("onnxruntime", "onnxscript"), "torch": ()}

Run = Callable[[Tensor], Tensor]


def available() -> list[str]:
    """The backends that can run here, fastest first."""
    return [name for name in BACKENDS if all(find_spec(module) is not None for module in NEEDS[name])]


def runner(model: nn.Module, backend: str | None = None, threads: int | None = None) -> Run:
    """A function from theta (B,4) to maps (B,1,80,64,40) [mm], float32 on the host, without gradients.

    Args:
        model: A surrogate on the host.
        backend: "torch", "onnxruntime" or "openvino"; by default the fastest that is installed.
        threads: Cores to use; all of this process by default.

    Raises:
        SDMError: The backend is not there.
    """
    backend = available()[0] if backend is None else backend
    if backend not in available():
        raise SDMError(f"the backend {backend!r} is not installed here; use {', '.join(available())}")
    threads = len(os.sched_getaffinity(0)) if threads is None else threads
    if backend == "torch":
        return _torch(model.eval())
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "surrogate.onnx"
        export_onnx(model, file)
        return (_onnxruntime if backend == "onnxruntime" else _openvino)(file, threads)


def _torch(model: nn.Module) -> Run:
    def run(theta: Tensor) -> Tensor:
        with torch.inference_mode():
            return model(theta)

    return run


def _onnxruntime(file: Path, threads: int) -> Run:
    import onnxruntime as ort  # pyright: ignore[reportMissingImports]

    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    session = ort.InferenceSession(file.read_bytes(), options, providers=["CPUExecutionProvider"])

    def run(theta: Tensor) -> Tensor:
        return torch.from_numpy(session.run(["sdm"], {"theta": _array(theta)})[0])

    return run


def _openvino(file: Path, threads: int) -> Run:
    import openvino  # pyright: ignore[reportMissingImports]

    core = openvino.Core()
    hints = {"INFERENCE_NUM_THREADS": threads, "PERFORMANCE_HINT": "LATENCY", "INFERENCE_PRECISION_HINT": "f32"}
    request = core.compile_model(core.read_model(file), "CPU", hints).create_infer_request()

    def run(theta: Tensor) -> Tensor:
        # A copy: the next call writes into the same memory.
        return torch.from_numpy(np.array(request.infer({"theta": _array(theta)})[0]))

    return run


def _array(theta: Tensor) -> np.ndarray:
    return np.ascontiguousarray(theta.detach().numpy(), dtype=np.float32)
