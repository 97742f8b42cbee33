"""Compiling is announced when it happens, and once."""

from __future__ import annotations

from types import ModuleType

import pytest

from sdm.cli.common.compile_notice import BUILDERS, NOTICE, announce_compiling
from sdm.kernels.launches import compiling


def test_the_first_build_is_announced(capsys):
    builders = ModuleType("builders")
    for name in BUILDERS:
        setattr(builders, name, lambda path, *, fast: f"{path} {fast}")
    for _ in range(2):
        announce_compiling(builders)
    assert capsys.readouterr().err == ""
    assert builders.build_cpu("a", fast=True) == "a True"
    assert builders.build_cuda("b", fast=False) == "b False"
    assert capsys.readouterr().err == f"{NOTICE}\n"


def test_the_library_does_not_say_it_again(monkeypatch, caplog):
    monkeypatch.setattr(compiling, "_said", set())
    compiling._say("cpu")
    assert "compiles its kernels" in caplog.text
    builders = ModuleType("builders")
    setattr(builders, BUILDERS[0], lambda: None)
    announce_compiling(builders)
    getattr(builders, BUILDERS[0])()
    caplog.clear()
    compiling._say("cuda:0")
    assert caplog.text == ""


def test_a_warp_without_them_is_left_alone():
    announce_compiling(ModuleType("builders"))


def test_this_warp_has_them():
    warp = pytest.importorskip("warp")
    assert all(hasattr(warp._src.build, name) for name in BUILDERS)
