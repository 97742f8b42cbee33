"""Fixtures and settings of every test: the data folder, the devices, hypothesis, and checks of tensors' shapes."""

# ruff: noqa: E402
from __future__ import annotations

import faulthandler
import gc
import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

# One process for each core and one thread in each: threads of several processes that wait for each other by spinning
# take ten times as long. Warp's launches still use several. Torch reads this as it is imported.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")

# A shell's job in the background ignores interrupts, and so would all commands that tests start and interrupt.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)

# What is imported and collected stays to the end. To look through it for garbage again and again is a tenth of a run.
gc.disable()

import hypothesis
import pytest
import torch
from _pytest.faulthandler import fault_handler_stderr_fd_key

from tests.helpers import array_types

ROOT = Path(__file__).resolve().parents[1]
array_types.install(ROOT)

from tests.helpers.compiling import first_compile

# Compiling a kernel counts towards the first example's time, so examples have no deadline of their own.
hypothesis.settings.register_profile("local", deadline=None, print_blob=True)
hypothesis.settings.register_profile("ci", deadline=None, derandomize=True, print_blob=True)
hypothesis.settings.load_profile("ci" if os.environ.get("CI") else "local")


@pytest.hookimpl(trylast=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    # What a crash says comes from the thread that crashed, not from the dozens that waited.
    faulthandler.enable(session.config.stash[fault_handler_stderr_fd_key], all_threads=False)


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> None:
    session.config.stash[first_compile.AT_COLLECTION] = first_compile.loaded()
    gc.freeze()
    # As for the command line: seldom. Tests that ask what is left collect it themselves.
    gc.set_threshold(10_000, 10, 10)
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if torch.cuda.is_available():
        return
    skip = pytest.mark.skip(reason="needs a CUDA device, and there is none")
    for item in items:
        if item.get_closest_marker("gpu"):
            item.add_marker(skip)


@pytest.fixture(scope="session", autouse=True)
def no_notice_of_compiling() -> Iterator[None]:
    """Tests count lines on stderr, which must not depend on whether Warp's cache has the kernels already."""
    from sdm.cli import app
    from sdm.kernels.launches import compiling

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(app, "announce_compiling", lambda: None)
        patch.setattr(compiling, "_said", {compiling.EVERY_DEVICE})
        yield


@pytest.fixture(scope="session", autouse=True)
def kernels_compiled_once(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> None:
    """The processes of a whole run share out what an empty cache lacks."""
    if "PYTEST_XDIST_WORKER" in os.environ and len(request.session.items) >= first_compile.MANY_TESTS:
        # Of a run's folder each process has a part.
        shared = tmp_path_factory.getbasetemp().parent / "compiles"
        shared.mkdir(exist_ok=True)
        first_compile.compile_missing(shared)


@pytest.fixture(scope="session", autouse=True)
def bounds_of_a_cochlea_once() -> Iterator[None]:
    """They are those of hundreds of shapes, and many tests ask for a grid that holds the same family."""
    from sdm.shapes import Cochlea

    found: dict[str, tuple[torch.Tensor, torch.Tensor]] = {}
    plain = Cochlea.bounds

    def bounds(self: Cochlea) -> tuple[torch.Tensor, torch.Tensor]:
        # What is asked about another default device is asked of the family itself.
        if type(self) is not Cochlea or torch.get_default_device().type != "cpu":
            return plain(self)
        if (key := self.fingerprint) not in found:
            found[key] = plain(self)
        low, high = found[key]
        return low.clone(), high.clone()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Cochlea, "bounds", bounds)
        yield


@pytest.fixture(scope="session")
def root() -> Path:
    """The checkout."""
    return ROOT


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Real meshes and images, which do not belong to the project: $SDM_DATA, else ../shared/data."""
    folder = Path(os.environ.get("SDM_DATA") or ROOT.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"needs the data folder {folder.name}, which is not here; SDM_DATA can name it")
    return folder


@pytest.fixture
def whole_gpu() -> None:
    """For tests that count the memory of all of a GPU: not beside the other processes of a parallel run."""
    if int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")) > 1:
        pytest.skip("counts the memory of all of the GPU: run it without -n")


@pytest.fixture(params=["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def device(request: pytest.FixtureRequest) -> str:
    """Each device in turn; "cuda" is skipped where there is none."""
    return request.param
