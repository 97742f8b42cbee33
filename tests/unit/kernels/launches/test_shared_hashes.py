"""Hashes that modules of kernels share: the same as those that Warp finds for each module by itself."""

from __future__ import annotations

import importlib
import pkgutil
import sys

import pytest
import warp as wp
from warp._src import context as warp_context

import sdm.kernels
from sdm.kernels.launches import shared_hashes

FOLDERS = ("bvh", "dense", "flood", "points", "surface", "winding")


def modules() -> list[wp.Module]:
    for folder in FOLDERS:
        package = importlib.import_module(f"sdm.kernels.{folder}")
        for found in pkgutil.iter_modules(package.__path__):
            importlib.import_module(f"{package.__name__}.{found.name}")
    names = sorted(name for name in sys.modules if name.startswith("sdm.kernels."))
    known = warp_context.user_modules
    return [known[name] for name in names if name in known and known[name]._get_live_kernels()]


@pytest.mark.parametrize("block_dim", [1, 128])
def test_the_same_as_module_by_module(block_dim):
    hasher, ours = warp_context.ModuleHasher, modules()
    assert len(ours) > 20
    options = [module.resolve_options(wp.config, block_dim=block_dim) for module in ours]
    shared = [hasher(module._get_live_kernels(), more) for module, more in zip(ours, options, strict=True)]
    shares = hasher.hash_function
    hasher.hash_function = shares.__wrapped__
    try:
        plain = [hasher(module._get_live_kernels(), more) for module, more in zip(ours, options, strict=True)]
    finally:
        hasher.hash_function = shares
    assert [one.get_hash() for one in shared] == [one.get_hash() for one in plain]
    assert [sorted(one.unique_kernels) for one in shared] == [sorted(one.unique_kernels) for one in plain]


def test_each_function_once(monkeypatch):
    found = []
    hasher = warp_context.ModuleHasher
    plain = hasher.hash_adjoint
    monkeypatch.setattr(hasher, "hash_adjoint", lambda self, adj: found.append(adj) or plain(self, adj))
    monkeypatch.setattr(shared_hashes, "_known", {})
    shares = hasher.hash_function
    monkeypatch.setattr(hasher, "hash_function", shares.__wrapped__)
    shared_hashes.share_hashes()
    for module in modules():
        hasher(module._get_live_kernels(), module.resolve_options(wp.config, block_dim=128))
    assert len({id(adj) for adj in found}) == len(found)


def test_functions_of_others_are_left_alone():
    known = shared_hashes._known
    assert all(function.module.name.startswith("sdm.kernels.") for function in known)
    assert sdm.kernels.__name__ == "sdm.kernels"
