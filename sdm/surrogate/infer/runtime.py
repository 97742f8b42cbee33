"""Runtimes of a surrogate on a CPU: torch, ONNX Runtime, OpenVINO."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from sdm.errors import SDMError
from sdm.kernels.launch import cores
from sdm.surrogate.infer.folded import FoldedNetwork
from sdm.surrogate.infer.onnx import export_halves, export_onnx
from sdm.surrogate.infer.openvino_stages import Stages, has_bfloat16
from sdm.surrogate.networks.sdmnn_plus import SDMNNPlus
from sdm.training.precision import cpu_has_bfloat16

# Fastest first, as `python -m sdm.bench.surrogate --parts timing` measures; the first that is installed is the default,
# but for SDMNN+ in bfloat16, which ONNX Runtime has not: there torch takes a third of its time.
BACKENDS = ("openvino", "onnxruntime", "torch")
NEEDS = {"openvino": ("openvino", "onnxscript"), "onnxruntime": ("onnxruntime", "onnxscript"), "torch": ()}

Run = Callable[[Tensor], Tensor]


def available() -> list[str]:
    """The backends that can run here, fastest first."""
    return [name for name in BACKENDS if all(find_spec(module) is not None for module in NEEDS[name])]


def runner(model: nn.Module, backend: str | None = None, threads: int | None = None, *, bfloat16: bool = True) -> Run:
    """A function from theta (B,4) to maps (B,1,80,64,40) [mm], float32 on the host, without gradients.

    Args:
        model: A surrogate on the host.
        backend: "torch", "onnxruntime" or "openvino"; by default the fastest that is installed.
        threads: Cores to use; all of this process by default. The backend "torch" uses as many as
            `torch.set_num_threads` has set, whatever is given here, and one for SDMNN+ in bfloat16.
        bfloat16: Let torch and OpenVINO work out the refinement of SDMNN+ in bfloat16 where the processor has it: by
            torch in half of the time, and within 0.01 mm of float32 (0.0002 mm in the mean; the network's own error
            is 0.003).

    Raises:
        SDMError: The backend is not there.
    """
    backend = _fastest(model, bfloat16) if backend is None else backend
    if backend not in available():
        raise SDMError(f"the backend {backend!r} is not installed here; use {', '.join(available())}")
    threads = cores() if threads is None else threads
    if backend == "torch":
        model.eval()
        if isinstance(model, SDMNNPlus):
            return FoldedNetwork(model, torch.bfloat16 if bfloat16 and cpu_has_bfloat16() else torch.float32)
        return _torch(model)
    with tempfile.TemporaryDirectory() as folder:
        files = [(Path(folder) / "surrogate.onnx", "f32")]
        if backend == "openvino" and bfloat16 and isinstance(model, SDMNNPlus) and has_bfloat16():
            files = [(Path(folder) / "interpolated.onnx", "f32"), (Path(folder) / "refined.onnx", "bf16")]
            export_halves(model, files[0][0], files[1][0])
        else:
            export_onnx(model, files[0][0])
        return _onnxruntime(files[0][0], threads) if backend == "onnxruntime" else _openvino(files, threads)


def _fastest(model: nn.Module, bfloat16: bool) -> str:
    first = available()[0]
    quick = bfloat16 and isinstance(model, SDMNNPlus) and cpu_has_bfloat16()
    return "torch" if quick and first == "onnxruntime" else first


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


def _openvino(files: list[tuple[Path, str]], threads: int) -> Run:
    stages = Stages(files, threads)
    return lambda theta: torch.from_numpy(stages(_array(theta)))


def _array(theta: Tensor) -> np.ndarray:
    return np.ascontiguousarray(theta.detach().numpy(), dtype=np.float32)
