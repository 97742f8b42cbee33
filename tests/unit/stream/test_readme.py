"""The samples on the stream's page run, on the CPU, with fewer voxels."""

from __future__ import annotations

import re

import pytest
import torch

import sdm

FENCE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def test_python_samples_run(root, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (root / "sdm" / "stream" / "README.md").read_text()
    if not torch.cuda.is_available():
        page = page.replace("family.grid(64)", "family.grid(8)")
    samples = FENCE.findall(page)
    assert len(samples) == 2
    namespace: dict[str, object] = {}
    for number, text in enumerate(samples):
        exec(compile(text, f"sample {number + 1}", "exec"), namespace)
    assert isinstance(namespace["field"], sdm.SDM)
    assert isinstance(namespace["maps"], torch.Tensor)


@pytest.mark.parametrize("word", ["--resume", "--verify", "--ray", "--count"])
def test_options_of_the_page_are_there(root, word, capsys):
    from sdm.cli import main

    assert word in (root / "sdm" / "stream" / "README.md").read_text()
    assert main(["generate", "--help"]) == 0
    assert word in capsys.readouterr().out
