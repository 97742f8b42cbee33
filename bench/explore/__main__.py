"""Updates a second of the page of `sdm explore`, from the value of a slider to what is sent to a client.

`python -m sdm.bench.explore` prints a table; `--out FILE.json` keeps it. A client in a process of its own takes all
that is sent and draws nothing, so a browser's own time is not counted. Rounds of the cases are interleaved.
"""

from __future__ import annotations

import argparse
import io
import os
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.core.demo_mesh import demo_mesh
from sdm.core.device import choose_device
from sdm.explore.controls import Slider
from sdm.explore.family_scene import EXACT, METHOD
from sdm.explore.mesh_scene import MeshScene
from sdm.explore.newest_values import NewestValues
from sdm.explore.page import PLACE, Page
from sdm.explore.scene_of import scene_of

RESOLUTION = 64
CLIENT = """
import sys
import viser
from websockets.sync.client import connect
with connect(sys.argv[1], max_size=None, proxy=None, subprotocols=["viser-v" + viser.__version__]) as taken:
    print("here", flush=True)
    for _ in taken:
        pass
"""


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the updates a second of sdm explore.")
    parser.add_argument("--device", default="cpu", help="where maps are computed: cpu, cuda or cuda:N")
    parser.add_argument("--rounds", type=int, default=7, help="of each case, in turns; the median counts")
    parser.add_argument("--updates", type=int, default=30, help="of a round")
    parser.add_argument("--out", type=Path, help="also write the figures to this JSON file")
    options = parser.parse_args()
    record = measure(options.device, options.rounds, options.updates)
    for row in record["cases"]:
        print(
            f"{row['case']:<46}{row['updates_a_second']:7.1f} a second "
            f"({row['slowest']:.1f} to {row['fastest']:.1f}), {row['cpu_ms']:.1f} ms of CPU each"
        )
    if options.out is not None:
        write(options.out, record)


def measure(device: str, rounds: int, updates: int) -> dict[str, Any]:
    """Updates a second of each case: the median of the rounds, with the slowest and the fastest one."""
    where = choose_device(device)
    cochlea = scene_of("cochlea", resolution=RESOLUTION, device=where)[0]
    ellipsoid = scene_of("ellipsoid", resolution=RESOLUTION, device=where)[0]
    mesh = MeshScene(demo_mesh(), RESOLUTION, where)
    cases = {
        "built-in mesh, its plane is dragged": (mesh, {}, PLACE),
        "cochlea by the surrogate, a slider is dragged": (cochlea, {}, None),
        "cochlea by the exact engine, a slider is dragged": (cochlea, {METHOD: EXACT}, None),
        "ellipsoid by the exact engine, a slider is dragged": (ellipsoid, {}, None),
    }
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in cases}
    for number in range(rounds + 1):
        for name, (scene, values, dragged) in cases.items():
            with page_of(scene) as page:
                found = _round(page, values, dragged or _first_slider(scene), updates)
            # The first round compiles and loads.
            times[name] += [found] if number else []
    rows = []
    for name, found in times.items():
        rates = [1 / wall for wall, _ in found]
        rows.append(
            {
                "case": name,
                "updates_a_second": statistics.median(rates),
                "slowest": min(rates),
                "fastest": max(rates),
                "cpu_ms": 1e3 * statistics.median(cpu for _, cpu in found),
            }
        )
    return {
        "machine": describe(device, ("warp-lang", "torch", "numpy", "viser", "openvino", "onnxruntime")),
        "load_average": os.getloadavg()[0],
        "resolution": RESOLUTION,
        "rounds": rounds,
        "updates": updates,
        "cases": rows,
    }


def _first_slider(scene: Any) -> str:
    return next(control.label for control in scene.controls if isinstance(control, Slider))


def _round(page: Page, values: dict[str, Any], name: str, updates: int) -> tuple[float, float]:
    """Wall and CPU seconds of an update, over the range of a slider."""
    control = next((c for c in page.scene.controls if c.label == name), None)
    low, high = (control.low, control.high) if isinstance(control, Slider) else (0.0, 1.0)
    page.draw(dict(values))
    draw: Callable[[dict[str, Any]], None] = page.draw
    begin, cpu = time.perf_counter(), time.process_time()
    for value in np.linspace(low, high, updates):
        draw({name: float(value)})
    return (time.perf_counter() - begin) / updates, (time.process_time() - cpu) / updates


@contextmanager
def page_of(scene: Any) -> Iterator[Page]:
    """A page on a server of viser's, with a client that takes what is sent."""
    import viser

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with redirect_stdout(io.StringIO()):
        server: Any = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
    client = subprocess.Popen(
        [sys.executable, "-c", CLIENT, f"ws://127.0.0.1:{port}"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    try:
        page = Page(server, scene, NewestValues())
        assert client.stdout is not None
        if client.stdout.readline().strip() != b"here":
            raise RuntimeError("the client did not reach the server")
        yield page
    finally:
        client.terminate()
        client.wait()
        with redirect_stdout(io.StringIO()):
            server.stop()


if __name__ == "__main__":
    main()
