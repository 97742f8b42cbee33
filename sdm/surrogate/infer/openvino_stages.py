"""A surrogate by OpenVINO, as one network or as stages of different precision."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np


def has_bfloat16() -> bool:
    """True if this processor multiplies bfloat16 faster than float32."""
    import openvino  # pyright: ignore[reportMissingImports]

    return "BF16" in openvino.Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES")


class Stages:
    """Networks one after another, each taking the outputs of the one before by their names.

    Args:
        files: An ONNX file and its precision, "f32" or "bf16", for each stage. The first takes `theta`, the last gives
            `sdm`.
        threads: Cores to use.

    Batches of one are what a fit asks for: for them the networks are compiled once more with fixed shapes, which saves
    another twentieth.
    """

    def __init__(self, files: Sequence[tuple[Path, str]], threads: int) -> None:
        import openvino  # pyright: ignore[reportMissingImports]

        self._core = openvino.Core()
        self._hints = {"INFERENCE_NUM_THREADS": threads, "PERFORMANCE_HINT": "LATENCY"}
        # Read from memory: the files may be gone when a batch of one is first requested.
        self._stages = [(file.read_bytes(), precision) for file, precision in files]
        self._requests: dict[bool, list[Any]] = {}

    def __call__(self, theta: np.ndarray) -> np.ndarray:
        """Maps (B,1,80,64,40) float32 of theta (B,4) float32; the caller may keep them."""
        single = len(theta) == 1
        if single not in self._requests:
            self._requests[single] = self._compiled(single)
        first, *others = self._requests[single]
        first.infer({"theta": theta})
        last = first
        for request in others:
            for port in request.model_inputs:
                request.set_tensor(port.any_name, last.get_tensor(port.any_name))
            request.infer()
            last = request
        # A copy: the next call writes into the same memory.
        return np.array(last.get_tensor("sdm").data)

    def _compiled(self, single: bool) -> list[Any]:
        requests = []
        for content, precision in self._stages:
            network = self._core.read_model(content, b"")
            if single:
                network.reshape({port.any_name: _of_one(port) for port in network.inputs})
            hints = {**self._hints, "INFERENCE_PRECISION_HINT": precision}
            requests.append(self._core.compile_model(network, "CPU", hints).create_infer_request())
        return requests


def _of_one(port: Any) -> list[int]:
    return [1, *(dimension.get_length() for dimension in list(port.partial_shape)[1:])]
