"""Surrogates as ONNX files, for runtimes without torch."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from sdm.errors import SDMError
from sdm.io.files.atomic import replacing
from sdm.surrogate.networks.sdmnn_plus import SDMNNPlus

OPSET = 18


# Two shapes, as one would make the batch a constant.
EXAMPLE = ((3.7, 0.45, 0.146, 0.6), (2.0, 0.0, 0.05, 0.0))


def export_onnx(model: nn.Module, target: Path) -> None:
    """Write a surrogate as ONNX: input `theta` (batch,4), output `sdm` (batch,1,80,64,40) [mm], any batch size.

    Args:
        model: A surrogate on the host.
        target: Path of the file.

    Raises:
        SDMError: The exporter is not installed.
    """
    _export(model.eval(), (torch.tensor(EXAMPLE),), ["theta"], ["sdm"], target)


def export_halves(model: SDMNNPlus, first: Path, second: Path) -> None:
    """Write what of SDMNN+ needs float32 and what does not as two files: `interpolated`, whose outputs `refined` takes.

    Raises:
        SDMError: The exporter is not installed.
    """
    between = ["around", "gains", "plain"]
    theta = torch.tensor(EXAMPLE)
    with torch.no_grad():
        example = model.eval().interpolated(theta)
    _export(_Method(model, model.interpolated), (theta,), ["theta"], between, first)
    _export(_Method(model, model.refined), example, between, ["sdm"], second)


class _Method(nn.Module):
    """A method of a model as a module, which is what the exporter takes."""

    def __init__(self, model: nn.Module, method: Callable[..., Any]) -> None:
        super().__init__()
        self.model, self._method = model, method

    def forward(self, *inputs: Tensor) -> Any:
        return self._method(*inputs)


def _export(
    module: nn.Module, example: tuple[Tensor, ...], inputs: list[str], outputs: list[str], target: Path
) -> None:
    try:
        import onnxscript  # noqa: F401  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise SDMError("export to ONNX needs the extra `onnx`: pip install '.[onnx]' in a clone") from error
    batch = torch.export.Dim("batch", min=1, max=4096)
    # One for each input; those of a `_Method` are one argument, `*inputs`.
    shapes = tuple({0: batch} for _ in example)
    with warnings.catch_warnings(), replacing(target) as part:
        # The exporter warns of its own parts.
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            module,
            example,
            input_names=inputs,
            output_names=outputs,
            dynamic_shapes=(shapes,) if isinstance(module, _Method) else shapes,
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
        part.write_bytes(program.model_proto.SerializeToString())  # pyright: ignore[reportOptionalMemberAccess]
