"""`sdm demo`: from the built-in mesh to its map and a picture, with what it took."""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from sdm.cli.common.argument_types import Device

if TYPE_CHECKING:
    import torch

    from sdm.core.grid import Grid
    from sdm.core.mesh import TriangleMesh
    from sdm.core.signed_distance_map import SDM

# The cochlea whose map the surrogate shows: a [mm], alpha [mm], b [1/rad], phi [rad].
SURROGATE_THETA = (3.7, 0.45, 0.146, 0.6)
SURROGATE_RUNS = 9


def demo(
    resolution: int = 128,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("demo"),
    device: Device = "auto",
) -> None:
    """Compute the signed distance map of the built-in mesh, a cochlea in millimetres.

    Writes demo.ply (the mesh), demo.nii.gz (the map) and demo.png (its slices and surface), and prints what it did.
    Where a trained surrogate is installed, surrogate.png shows its map of another cochlea beside the exact one.

    Args:
        resolution: Voxels along each axis.
        out: Folder to write to; made if it is not there.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    import torch

    from sdm.core.demo_mesh import demo_mesh
    from sdm.core.device import choose_device, require_memory
    from sdm.core.grid import Grid
    from sdm.errors import FormatError, GridError
    from sdm.io.meshes.write import write_ply
    from sdm.viz import picture

    mesh = demo_mesh()
    grid = Grid.around(mesh, resolution=resolution)
    if resolution < 2:
        raise GridError(f"--resolution is {resolution}; give at least 2, as the picture shows the map's surface")
    chosen = choose_device(device)
    # Before a folder is made, and before the small map that the demo begins with.
    require_memory(grid.nbytes, torch.device("cpu"), f"a map of {' x '.join(map(str, grid.shape))} voxels")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FormatError(f"the folder {out} cannot be made: {error.strerror}") from error

    name = _name(chosen)
    spacing = grid.spacing[0]
    _say("mesh", f"{mesh.name}, {len(mesh):,} triangles")
    _say("grid", f"{' x '.join(map(str, grid.shape))} voxels of {spacing:.4g} mm, {grid.nbytes / 2**20:.3g} MiB")
    _say("device", name)
    _say("prepare", "loading the kernels, or compiling them: the first time about ten seconds, more on a busy machine")
    seconds = _seconds_to_prepare(mesh, chosen)
    _say("prepared", f"in {seconds:.3g} s")
    field, seconds = _timed_map(mesh, grid, chosen)
    _say("computed", f"in {seconds:.3g} s: {grid.size / seconds / 1e6:.3g} million exact signed distances a second")
    inside = int((field.values < 0).sum()) * spacing**3
    low, high = float(field.values.min()), float(field.values.max())
    _say("map", f"{low:.4g} mm (deepest inside) to {high:.4g} mm, {inside:.4g} mm3 inside")

    facts = {"mesh": mesh.name, "triangles": f"{len(mesh):,}", "time": f"{seconds:.3g} s", "device": name}
    write_ply(mesh, out / "demo.ply")
    field.save(out / "demo.nii.gz")
    picture(field, out / "demo.png", title=f"Exact signed distance map of the {mesh.name}", unit="mm", facts=facts)
    _say("wrote", ", ".join(str(out / f"demo.{end}") for end in ("ply", "nii.gz", "png")))
    _surrogate(out / "surrogate.png")


def _surrogate(target: Path) -> None:
    """The shipped surrogate beside the exact map of the same parameters; nothing where none is shipped."""
    from sdm.surrogate.infer.predict import shipped_weights

    if shipped_weights() is None:
        return
    from sdm.surrogate.infer.exact_map import exact_map
    from sdm.surrogate.infer.predict import predict
    from sdm.viz.side_by_side import side_by_side

    exact, predicted = exact_map(SURROGATE_THETA), predict(SURROGATE_THETA)
    times = []
    for _ in range(SURROGATE_RUNS):
        start = time.perf_counter()
        predict(SURROGATE_THETA)
        times.append(time.perf_counter() - start)
    seconds = statistics.median(times)
    error = (predicted.values - exact.values).abs()
    near = error[exact.values.abs() < 0.5]
    _say(
        "surrogate",
        f"a network's map of a cochlea in {seconds:.3g} s on the CPU, from four parameters without a mesh: "
        f"{float(error.mean()):.3f} mm from the exact one on average, {float(near.mean()):.3f} mm near the surface",
    )
    side_by_side(exact, predicted, target, title="A cochlea by its mesh, exactly, and by a network")
    _say("wrote", str(target))


def _say(what: str, text: str) -> None:
    print(f"{what:<10}{text}", flush=True)


def _seconds_to_prepare(mesh: TriangleMesh, device: torch.device) -> float:
    """A small map, so that the time of the large one holds no compiling."""
    from sdm.core.grid import Grid

    return _timed_map(mesh, Grid.around(mesh, resolution=32), device)[1]


def _timed_map(mesh: TriangleMesh, grid: Grid, device: torch.device) -> tuple[SDM, float]:
    """The map, and the seconds from a mesh on the device to its map there."""
    from sdm.engine.api import signed_distance_map

    mesh = mesh.to(device)
    _wait(device)
    start = time.perf_counter()
    field = signed_distance_map(mesh, grid, device=device)
    _wait(device)
    return field, time.perf_counter() - start


def _wait(device: torch.device) -> None:
    import torch

    if device.type == "cuda":
        torch.cuda.synchronize(device)


def _name(device: torch.device) -> str:
    import torch

    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    from sdm.kernels.launch import threads

    return f"CPU, {threads()} threads"
