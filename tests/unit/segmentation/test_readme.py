"""The page's sample runs, and its methods are those that there are."""

from __future__ import annotations

import re

from sdm.segmentation import METHODS
from tests.helpers.segmentation_cases import write_nnunet


def test_the_sample_runs(root, tmp_path, monkeypatch):
    text = (root / "sdm" / "segmentation" / "README.md").read_text()
    (code,) = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    write_nnunet(tmp_path / "FOLDER")
    monkeypatch.chdir(tmp_path)
    namespace: dict = {}
    exec(compile(code, "README.md", "exec"), namespace)
    assert namespace["found"].label.shape == namespace["cases"][0].image.shape


def test_every_method_is_told(root):
    text = (root / "sdm" / "segmentation" / "README.md").read_text()
    told = set(re.findall(r"^\| `([\w-]+)` \|", text, re.MULTILINE))
    families = {re.sub("(head|branch)-.*", r"\1-MAP-LOSS", name) for name in METHODS}
    assert told - {"--method"} == families
