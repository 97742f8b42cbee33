"""Surrogates as ONNX files, for runtimes without torch."""

from __future__ import annotations

import warnings
from pathlib import Path

import torch
from torch import nn

from sdm.errors import SDMError
from sdm.io.atomic import replacing

OPSET = 18


def export_onnx(model: nn.Module, target: Path) -> None:
    """Write a surrogate as ONNX: input `theta` (batch,4), output `sdm` (batch,1,80,64,40) [mm], any batch size.

    Args:
        model: A surrogate on the host.
        target: Path of the file.

    Raises:
        SDMError: The exporter is not installed.
    """
    try:
        import onnxscript  # noqa: F401  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise SDMError("export to ONNX needs the extra `onnx`: pip install 'warp-sdm[onnx]'") from error
    # Two shapes, as one would make the batch a constant.
    example = torch.tensor([[3.7, 0.45, 0.146, 0.6], [2.0, 0.0, 0.05, 0.0]])
    batch = torch.export.Dim("batch", min=1, max=4096)
    with warnings.catch_warnings(), replacing(target) as part:
        # The exporter warns of its own parts.
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            model.eval(),
            (example,),
            input_names=["theta"],
            output_names=["sdm"],
            dynamic_shapes={"theta": {0: batch}},
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
        part.write_bytes(program.model_proto.SerializeToString())  # pyright: ignore[reportOptionalMemberAccess]
