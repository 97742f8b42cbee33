"""Processes of a whole run share out the kernels that an empty cache lacks."""

from __future__ import annotations

import pytest
import warp as wp

from tests.helpers.compiling import first_compile


class Module:
    """A module that is noted when it is loaded."""

    def __init__(self, name: str, loaded: list[str]) -> None:
        self.name, self._loaded = name, loaded

    def load(self, device: wp.Device, block_dim: int) -> None:
        assert (device.alias, block_dim) == ("cpu", 1)
        self._loaded.append(self.name)


@pytest.mark.parametrize("is_there", [False, True])
def test_each_module_is_compiled_by_one(monkeypatch, tmp_path, is_there):
    loaded: list[str] = []
    monkeypatch.setattr(first_compile, "_modules", lambda: [Module(name, loaded) for name in "abc"])
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "cache"))
    for number in range(first_compile.ENOUGH if is_there else 0):
        (tmp_path / "cache" / f"wp_{number}").mkdir(parents=True)
    shared = tmp_path / "shared"
    shared.mkdir()
    if not is_there:
        # Another process has begun with it.
        assert first_compile.claim(shared / "b")
    for _process in range(2):
        first_compile.compile_missing(shared)
    assert loaded == ([] if is_there else ["a", "c"])


def test_modules_are_those_of_the_package():
    names = [module.name for module in first_compile._modules()]
    assert "sdm.kernels.dense.stage5_select" in names
    assert not any(name.startswith(("tests.", "warp.")) for name in names)


def test_no_kernel_is_loaded_as_tests_are_collected(request):
    """Each process collects all tests, and would compile what they launch meanwhile."""
    assert request.config.stash[first_compile.AT_COLLECTION] == []
