"""Seeds for one purpose each."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch

from sdm.core.random import derive_seed, generator
from sdm.deepsdf.networks.auto_decoder import AutoDecoder
from sdm.deepsdf.train.settings import Settings
from sdm.errors import SDMError

PURPOSES = [(), ("a",), ("a", "b"), ("ab",), ("a", "", "b"), ("b", "a"), (1,), ("1",), (-1,), (1, 2), (12,), ("i1:1",)]
SEEDS = [0, 1, 2, -1, 2**32, 2**63, 2**64, 2**64 - 1, -(2**63), 10**23, 10**5000]


def test_every_seed_and_purpose_has_its_own():
    seeds = [derive_seed(seed, *what) for seed in SEEDS for what in PURPOSES]
    assert len(set(seeds)) == len(SEEDS) * len(PURPOSES)
    assert min(seeds) >= 0
    assert max(seeds) < 2**63


def test_the_same_on_every_machine_and_in_every_version():
    # Half of the first 8 bytes, little-endian, that sha256sum has for i1:7 and for i1:7s5:noisei2:ff.
    assert derive_seed(7) == 1526557006729076612
    assert derive_seed(7, "noise", 255) == 9010152732197370328
    assert derive_seed(np.int64(7), "noise", np.uint8(255)) == derive_seed(7, "noise", 255)


def test_half_of_the_bits_change():
    words = np.array([derive_seed(seed, "step", step) for seed in range(32) for step in range(32)], dtype=np.uint64)
    changed = np.bitwise_count(words[1:] ^ words[:-1])
    # 63 bits, each with a chance of a half, 1,023 times.
    assert abs(changed.mean() - 31.5) < 0.6
    assert changed.min() > 10


def test_neither_words_nor_whole_numbers_are_refused():
    for wrong in (0.5, None, b"a", ("a",)):
        with pytest.raises(TypeError):
            derive_seed(0, wrong)  # type: ignore[arg-type]
    with pytest.raises(SDMError, match="the seed is '0'; give a whole number"):
        derive_seed("0")  # type: ignore[arg-type]


def test_generators_start_from_it():
    one, two = (torch.rand(4, generator=generator(2**64, "a", step)) for step in (0, 1))
    assert torch.equal(one, torch.rand(4, generator=torch.Generator().manual_seed(derive_seed(2**64, "a", 0))))
    assert not torch.equal(one, two)


def test_a_model_of_a_long_seed():
    codes = [AutoDecoder(Settings(seed=10**23 + i), 2).codes for i in (0, 0, 1)]
    assert torch.equal(codes[0], codes[1])
    assert not torch.equal(codes[0], codes[2])


def calls(root: Path, *tops: str):
    """Calls in the modules of the library and of the benchmarks: module, name of the function, call."""
    for top in tops:
        for path in sorted((root / top).rglob("*.py")):
            if path.relative_to(root).parts[:2] in (("sdm", "kernels"), ("sdm", "bench")):
                continue
            text = path.read_text()
            if "random" not in text and "manual_seed" not in text:
                continue
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, ast.Call):
                    name = getattr(node.func, "attr", getattr(node.func, "id", ""))
                    yield path.relative_to(root), name, node


def test_no_two_places_have_one_purpose(root):
    purposes = Counter()
    for path, name, call in calls(root, "sdm", "bench"):
        if name in ("derive_seed", "generator") and len(call.args) > 1 and path != Path("sdm/core/random.py"):
            first, what = call.args[:2]
            # `query_points.generator` takes a case where ours takes a seed.
            if "case" not in ast.unparse(first):
                purposes[ast.literal_eval(what)] += 1
    assert purposes
    assert not [what for what, count in purposes.items() if count > 1]


def test_every_seed_of_the_library_is_derived(root):
    makers = ("manual_seed", "default_rng", "Philox", "PCG64", "SeedSequence", "RandomState")
    # Has its seed, derived, from `augment.draw`.
    known = {"sdm/segmentation/data/patches.py", "sdm/core/random.py"}
    loose = [
        f"{path}:{call.lineno}"
        for path, name, call in calls(root, "sdm")
        if name in makers and str(path) not in known and "derive_seed(" not in ast.unparse(call)
    ]
    assert not loose
