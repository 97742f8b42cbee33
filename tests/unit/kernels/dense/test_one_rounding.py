"""Stage 6 with winners and without: no operation whose rounding is left to a compiler, and the same ones in both."""

from __future__ import annotations

import re
import sys
from collections import Counter

import pytest
import warp as wp

from sdm.kernels.dense import stage6_measure

# Without `.rn` a compiler may make one operation of a product and a sum, or not, as it sees fit.
LEFT_OPEN = re.compile(r"\b(?:add|sub|mul|mad)\.(?:ftz\.)?f(?:32|64)\b")
ROUNDED = re.compile(r"\b(?:add|sub|mul|fma)\.rn\.f(?:32|64)\b")


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp has no compiler for GPUs there")
def test_distances_are_rounded_alike(tmp_path):
    operations = []
    for kernel in (stage6_measure._measure_blocks, stage6_measure._measure_winners):
        folder = tmp_path / kernel.key
        wp.compile_aot_module(kernel.module, arch=90, module_dir=str(folder), use_ptx=True)
        (file,) = folder.glob("*.ptx")
        text = file.read_text()
        assert not LEFT_OPEN.findall(text)
        operations.append(Counter(ROUNDED.findall(text)))
    assert operations[0] == operations[1]
    assert operations[0]["fma.rn.f32"] > 200
