"""`sdm sample`: layouts as their own readers read them; the same bytes when resumed, and by any number of threads."""

from __future__ import annotations

import io
import json
import os
import shutil
import sys
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
import zarr

import sdm
from sdm.cli import main
from sdm.cli.maps.sample_run import SampleOptions
from sdm.cli.maps.sample_run import run as run_sampling
from sdm.core.normalization import Normalization
from sdm.io.files.lock import alone
from sdm.io.meshes.split_file import write_split
from sdm.sampling import sample
from sdm.sampling.layouts import zarr_samples
from sdm.sampling.layouts.zarr_samples import read_zarr
from tests.helpers.processes.killed_command import killed_after

COUNT = 400
PLACES = ("02691156/aa", "02691156/bb", "03001627/cc")


@pytest.fixture(scope="module")
def shapes(tmp_path_factory) -> Path:
    """A folder as ShapeNet has it, with one mesh that has a hole."""
    root = tmp_path_factory.mktemp("shapes") / "ShapeNetV2"
    for number, place in enumerate((*PLACES, "03001627/open")):
        folder = root / place / "models"
        folder.mkdir(parents=True)
        ball = trimesh.creation.icosphere(2)
        ball.apply_transform(np.diag([1.0, 1 + 0.3 * number, 2, 1]))
        ball.apply_translation([5, -3, number])
        if place.endswith("open"):
            ball = trimesh.Trimesh(ball.vertices, ball.faces[:-1], process=False)
        ball.export(folder / "model_normalized.obj")
    return root


def run(*words: object) -> int:
    return main(["sample", *map(str, words), "--device", "cpu", "--count", str(COUNT)])


def files(folder: Path) -> dict[str, bytes]:
    """All files but the report, which has times."""
    paths = (path for path in folder.rglob("*") if path.is_file() and path.name != "report.json")
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def deepsdf_batch(folder: Path, split: dict[str, dict[str, list[str]]], count: int) -> dict[str, torch.Tensor]:
    """Batches of facebookresearch/DeepSDF (deep_sdf/data.py) by instance: half of the rows outside, half inside.

    It finds files by dataset, class and instance of a split, keeps rows whose fourth number is not NaN, draws rows with
    repetition from tensors that are float32 as they are kept, and needs as many rows outside as half of its batch.
    """
    found = {}
    for dataset, classes in split.items():
        for category, instances in classes.items():
            for instance in instances:
                name = os.path.join(dataset, category, instance + ".npz")
                kept = np.load(folder / "SdfSamples" / name)
                assert sorted(kept) == ["neg", "pos"]
                sides = [torch.from_numpy(kept[side]) for side in ("pos", "neg")]
                assert all(len(side) and not side.isnan().any() for side in sides)
                assert len(sides[0]) >= count // 2
                draws = [side[torch.randint(len(side), (count // 2,))] for side in sides]
                found[name] = torch.cat(draws)
    return found


def occupancy_models(folder: Path, part: str) -> list[Path]:
    """Models as Occupancy Networks (im2mesh/data/core.py) list them: every folder is a class, every line a model."""
    classes = [place for place in sorted(folder.iterdir()) if place.is_dir()]
    return [place / name for place in classes for name in (place / f"{part}.lst").read_text().split("\n")]


def test_deepsdf_reads_its_layout(shapes, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(shapes, "-o", out, "--skip-bad") == 0
    said = capsys.readouterr().out
    assert "400 samples of each of 3 meshes" in said
    assert "is not closed" in said
    split = json.loads((out / "splits" / "all.json").read_text())
    assert split == {"ShapeNetV2": {"02691156": ["aa", "bb"], "03001627": ["cc"]}}
    for name, rows in deepsdf_batch(out, split, 100).items():
        assert rows.shape == (100, 4)
        assert rows.dtype == torch.float32
        assert (rows[:50, 3] >= 0).all()
        assert (rows[50:, 3] < 0).all()
        # Its evaluate.py and generate_training_meshes.py undo the normalisation so: p / scale - offset.
        by = np.load(out / "NormalizationParameters" / name)
        points = rows[:, :3].numpy() / by["scale"] - by["offset"]
        category, instance = name.removesuffix(".npz").split("/")[1:]
        mesh = sdm.load_mesh(shapes / category / instance / "models" / "model_normalized.obj")
        exact = sdm.signed_distance(mesh, points, device="cpu").numpy() * by["scale"]
        np.testing.assert_allclose(exact, rows[:, 3], atol=3e-6)
    report = json.loads((out / "report.json").read_text())["meshes"]
    assert [entry["state"] for entry in report] == ["done", "done", "done", "failed"]
    assert report[0]["inside"] > 0
    alone = sample(
        shapes / "02691156/aa/models/model_normalized.obj",
        COUNT,
        name="02691156/aa/models/model_normalized",
        device="cpu",
    )
    rows = torch.cat([alone.points, alone.distances[:, None]], 1)
    kept = np.load(out / "SdfSamples/ShapeNetV2/02691156/aa.npz")
    np.testing.assert_array_equal(kept["neg"], rows[rows[:, 3] < 0].numpy())
    np.testing.assert_array_equal(kept["pos"], rows[rows[:, 3] >= 0].numpy())


def test_occupancy_networks_read_theirs(shapes, tmp_path):
    out = tmp_path / "out"
    assert run(shapes, "-o", out, "--layout", "occupancy", "--open-meshes", "keep") == 0
    models = occupancy_models(out, "all")
    assert [str(model.relative_to(out)) for model in models] == [*PLACES, "03001627/open"]
    for model in models:
        # The keys that PointsField and PointCloudField of im2mesh/data/fields.py read.
        assert sorted(np.load(model / "points.npz")) == ["loc", "occupancies", "points", "scale"]
        assert sorted(np.load(model / "pointcloud.npz")) == ["loc", "normals", "points", "scale"]
    points_dict = np.load(out / "02691156" / "bb" / "points.npz")
    points = points_dict["points"]
    assert points.dtype == np.float16
    occupancies = np.unpackbits(points_dict["occupancies"])[: points.shape[0]]
    loc, scale = points_dict["loc"].astype(np.float32), points_dict["scale"].astype(np.float32)
    assert points.shape == (COUNT // 2, 3)
    assert np.abs(points).max() <= 0.55
    mesh = sdm.load_mesh(shapes / "02691156/bb/models/model_normalized.obj")
    at = points.astype(np.float32) * scale + loc
    inside = sdm.signed_distance(mesh, at, device="cpu").numpy() < 0
    np.testing.assert_array_equal(inside, occupancies.astype(bool))
    cloud = np.load(out / "02691156" / "bb" / "pointcloud.npz")
    on = cloud["points"].astype(np.float32) * scale + loc
    assert np.abs(sdm.signed_distance(mesh, on, device="cpu").numpy()).max() < 2e-3 * scale
    assert np.allclose(np.linalg.norm(cloud["normals"].astype(np.float32), axis=1), 1, atol=2e-3)
    middle = Normalization.of(mesh, "cube")
    assert (cloud["normals"].astype(np.float32) * (on - np.asarray(middle.centre, np.float32))).sum(1).min() > 0


@pytest.mark.parametrize("layout", ["deepsdf", "occupancy"])
def test_parts_of_a_split(layout, shapes, tmp_path, capsys):
    """Lists of each part lie beside the samples of all; a part alone has the same samples, and no others."""
    folder = shutil.copytree(shapes, tmp_path / "shapes")
    whole, part = tmp_path / "all", tmp_path / "train"
    words = ["--layout", layout, "--dataset", "shapes", "--skip-bad"]
    assert run(folder, "-o", tmp_path / "no", *words, "--split", "train") == 2
    assert "sdm split makes it" in capsys.readouterr().err
    path = "{}/models/model_normalized.obj".format
    parts = {"train": [path(PLACES[0]), path("03001627/open"), path(PLACES[2])], "val": [path(PLACES[1])]}
    write_split(folder / "split.json", parts)
    assert run(folder, "-o", whole, *words) == 0
    assert run(folder, "-o", part, *words, "--split", "train") == 0
    if layout == "deepsdf":
        lists = {name: json.loads((whole / f"splits/{name}.json").read_text())["shapes"] for name in parts}
        assert lists == {"train": {"02691156": ["aa"], "03001627": ["cc"]}, "val": {"02691156": ["bb"], "03001627": []}}
    else:
        assert occupancy_models(whole, "train") == [whole / PLACES[0], whole / PLACES[2]]
        assert (whole / "02691156" / "val.lst").read_text() == "bb"
    told = json.loads((whole / "sampling.json").read_text())["parts"]
    assert told["val"] == ["02691156/bb/models/model_normalized"]
    kept, alone = files(whole), files(part)
    samples = {name for name in alone if name.endswith(".npz")}
    assert samples == {name for name in kept if name.endswith(".npz") and "bb" not in name}
    assert all(alone[name] == kept[name] for name in samples)
    assert run(folder, "-o", tmp_path / "no", *words, "--split", "tra") == 2
    assert "has no part 'tra', but train, val" in capsys.readouterr().err


def test_zarr_and_webdataset_hold_the_same(shapes, tmp_path):
    assert run(shapes, "-o", tmp_path / "z", "--layout", "zarr", "--skip-bad") == 0
    more = ["--layout", "webdataset", "--skip-bad", "--closest"]
    assert run(shapes, "-o", tmp_path / "w", *more) == 0
    names = (tmp_path / "w" / "shards.lst").read_text().split()
    found: dict[str, dict[str, bytes]] = {}
    for name in names:
        with tarfile.open(tmp_path / "w" / name) as tar:
            # As WebDataset groups: by what is before the first dot.
            for member in tar:
                key, _, ending = member.name.partition(".")
                file = tar.extractfile(member)
                assert file is not None
                found.setdefault(key, {})[ending] = file.read()
    assert list(found) == list(PLACES)
    for number, key in enumerate(PLACES):
        told = json.loads(found[key]["json"])
        assert told["path"] == f"{key}/models/model_normalized"
        arrays = np.load(io.BytesIO(found[key]["samples.npz"]))
        points, distances = read_zarr(tmp_path / "z", number)
        np.testing.assert_array_equal(arrays["points"], points)
        np.testing.assert_array_equal(arrays["distances"], distances)
        length = np.linalg.norm(arrays["closest"] - points, axis=1)
        np.testing.assert_allclose(length, np.abs(distances), atol=1e-6)
    assert np.isnan(read_zarr(tmp_path / "z", 3)[1]).all()


@pytest.mark.parametrize("layout", ["deepsdf", "occupancy", "zarr", "webdataset"])
def test_any_number_of_threads_and_a_resume_make_the_same_bytes(layout, shapes, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sdm.sampling.layouts.webdataset.SHARD_BYTES", 16 * COUNT * 2)
    options = SampleOptions(
        law=None, shares=(None, None, None), deviations=None, box=None, normalize=None, count=COUNT, closest=False,
        sign="winding", hole_size=None, open_meshes="keep", seed=5,
    )  # fmt: skip
    for workers in (1, 3):
        run_sampling([shapes], tmp_path / str(workers), layout, options, device="cpu", workers=workers)
    whole = files(tmp_path / "1")
    assert files(tmp_path / "3") == whole
    # Without some of the files, as after a kill.
    lost = [path for path in (tmp_path / "3").rglob("*") if path.suffix in (".npz", ".tar") or path.name == "0"]
    max(path for path in lost if path.is_file()).unlink()
    run_sampling([shapes], tmp_path / "3", layout, options, device="cpu", resume=True)
    assert files(tmp_path / "3") == whole
    report = json.loads((tmp_path / "3" / "report.json").read_text())["meshes"]
    assert {entry["state"] for entry in report} == {"done", "there already"}
    capsys.readouterr()
    assert run(shapes, "-o", tmp_path / "3", "--layout", layout) == 2
    assert "--resume goes on" in capsys.readouterr().err
    assert run(shapes, "-o", tmp_path / "3", "--layout", layout, "--resume", "--seed", "6") == 2
    assert "of another seed" in capsys.readouterr().err


def test_other_meshes_in_the_folder_change_nothing(shapes, tmp_path):
    alone = tmp_path / "ShapeNetV2"
    (alone / "02691156" / "bb" / "models").mkdir(parents=True)
    (alone / "02691156" / "zz" / "models").mkdir(parents=True)
    source = shapes / "02691156/bb/models/model_normalized.obj"
    for name in ("bb", "zz"):
        (alone / "02691156" / name / "models" / "model_normalized.obj").write_bytes(source.read_bytes())
    assert run(alone, "-o", tmp_path / "a") == 0
    assert run(shapes, "-o", tmp_path / "b", "--skip-bad") == 0
    own, other = files(tmp_path / "a"), files(tmp_path / "b")
    # Two of one class: the class is no part of what tells them apart, but their places are the same.
    bb = next(name for name in own if name.startswith("SdfSamples") and "bb" in name)
    zz = next(name for name in own if name.startswith("SdfSamples") and "zz" in name)
    assert own[bb] == other["SdfSamples/ShapeNetV2/02691156/bb.npz"]
    assert own[zz] != own[bb]


def test_sheets_by_a_flood_and_unsigned(shapes, tmp_path):
    assert run(shapes / "03001627", "-o", tmp_path / "f", "--sign", "flood", "--hole-size", "0.3") == 0
    assert json.loads((tmp_path / "f" / "report.json").read_text())["meshes"][1]["closed"] is False
    assert run(shapes / "03001627", "-o", tmp_path / "n", "--sign", "none", "--law", "released") == 0
    rows = np.load(next((tmp_path / "n" / "SdfSamples").rglob("open.npz")))
    assert len(rows["neg"]) == 0


@pytest.mark.parametrize("sign", ["winding", "flood"])
def test_faces_that_disagree_are_turned_as_in_a_single_call(sign, shapes, tmp_path, capsys):
    """A sentence that names an option names one that there is, and samples are those of a single call."""
    flipped = tmp_path / "in" / "flipped.off"
    flipped.parent.mkdir()
    mesh = sdm.load_mesh(shapes / "02691156/aa/models/model_normalized.obj")
    faces = mesh.faces.clone()
    faces[::3] = faces[::3].flip(1)
    sdm.save_mesh(sdm.TriangleMesh(mesh.vertices, faces), flipped)
    words = [flipped.parent, "--sign", sign, "--layout", "zarr", "-o"]
    if sign == "winding":
        assert run(*words, tmp_path / "keep", "--orient", "keep", "--open-meshes", "keep") == 2
        assert "--orient parts" in capsys.readouterr().err
    for orient in ("auto", "parts"):
        assert run(*words, tmp_path / orient, "--orient", orient) == 0
        alone = sample(flipped, COUNT, name="flipped", device="cpu", sign=sign, orient=orient)
        points, distances = read_zarr(tmp_path / orient, 0)
        np.testing.assert_array_equal(points, alone.points.numpy())
        np.testing.assert_array_equal(distances, alone.distances.numpy())
        assert (distances < 0).any()
    assert run(*words, tmp_path / "auto", "--orient", "parts", "--resume") == 2
    assert "samples of another orient" in capsys.readouterr().err


def test_samples_of_the_surface_alone_and_very_few(shapes, tmp_path, capsys):
    """Nothing of what lies on a surface is inside it, which is no reason to say that it encloses nothing."""
    words = [shapes / "02691156", "-o", tmp_path / "s", "--near", "0", "--uniform", "0", "--surface", "1"]
    assert run(*words, "--layout", "zarr") == 0
    points, distances = read_zarr(tmp_path / "s", 1)
    assert np.isfinite(points).all()
    assert not distances.any()
    few = [shapes / "02691156", "-o", tmp_path / "f", "--uniform", "1", "--near", "0", "--box", "0.001"]
    assert run(*few) == 0
    thin = tmp_path / "thin"
    thin.mkdir()
    trimesh.creation.box((1, 1, 1e-5)).export(thin / "thin.ply")
    capsys.readouterr()
    assert run(thin, "-o", tmp_path / "t") == 2
    assert "none of 400 samples around" in (said := capsys.readouterr().err)
    assert "encloses nothing, or too little for so few (--count)" in said


def test_bad_input_is_one_sentence(shapes, tmp_path, capsys):
    for words, said in (
        ([tmp_path], "no mesh was found"),
        ([shapes, "--near", "0", "--uniform", "0"], "is no law"),
        # They would lead out of the folder that is written.
        ([shapes, "--dataset", "../../other"], "is no name of a folder"),
        ([shapes, "--dataset", ".."], "is no name of a folder"),
        ([shapes, "--dataset", "/tmp/other"], "is no name of a folder"),
        ([shapes, "--closest"], "no place for closest points"),
        ([shapes, "--layout", "occupancy", "--sign", "none"], "tells what is inside"),
        ([shapes, "--hole-size", "1"], "hole_size"),
        # What would say nothing.
        ([shapes, "--layout", "occupancy", "--law", "released"], "has a law of its own"),
        ([shapes, "--layout", "occupancy", "--deviations", "0.1"], "of which this law has none: give --near too"),
        ([shapes, "--uniform", "0", "--box", "2"], "of which this law has none: give --uniform too"),
        ([shapes, "--sign", "flood", "--open-meshes", "reject"], "--sign flood takes meshes with holes"),
    ):
        assert run(*words, "-o", tmp_path / "out") == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert said in line
    assert not (tmp_path / "out").exists()


def test_kill_9_loses_what_is_in_flight(shapes, tmp_path):
    many = tmp_path / "many"
    many.mkdir()
    source = shapes / "02691156/bb/models/model_normalized.obj"
    for number in range(40):
        (many / f"{number:02}.obj").write_bytes(source.read_bytes())
    words = ["sample", str(many), "--device", "cpu", "--count", "2000", "-o"]
    killed_after([*words, str(tmp_path / "d")], tmp_path / "d", "SdfSamples/*/*/*.npz")
    for path in (tmp_path / "d").glob("SdfSamples/*/*/[!.]*.npz"):
        assert len(np.load(path)["pos"]) > 0
    assert main([*words, str(tmp_path / "d"), "--resume"]) == 0
    assert main([*words, str(tmp_path / "whole")]) == 0
    told = json.loads((tmp_path / "d" / "report.json").read_text())["meshes"]
    assert {entry["triangles"] for entry in told} == {len(sdm.load_mesh(source))}
    kept = {name: content for name, content in files(tmp_path / "d").items() if not name.endswith(".part")}
    assert kept == files(tmp_path / "whole")


def test_one_command_at_a_time_writes_to_a_folder(shapes, tmp_path, capsys):
    """Of two that begin at once, each would find no recipe, and the folder would hold samples of both."""
    out = tmp_path / "d"
    out.mkdir()
    for more in ((), ("--resume",)):
        with alone(out):
            assert run(shapes, "-o", out, *more) == 2
        assert "d is being written by another process: wait for it, or end it" in capsys.readouterr().err
        assert not list(out.iterdir())
    assert run(shapes, "-o", out, "--skip-bad") == 0


@pytest.mark.parametrize("after", range(5))
def test_zarr_that_was_cut_off_while_it_began(after, shapes, tmp_path, monkeypatch):
    """Arrays without a description could not be read, and nobody would say so."""
    words = [shapes, "--layout", "zarr", "--skip-bad", "-o"]
    assert run(*words, tmp_path / "whole") == 0
    left = [after]

    def cut(plain: Callable[..., Any]) -> Callable[..., Any]:
        def counted(*given: Any, **more: Any) -> Any:
            left[0] -= 1
            if left[0] < 0:
                raise KeyboardInterrupt
            return plain(*given, **more)

        return counted

    with monkeypatch.context() as patch:
        patch.setattr(zarr.Group, "create_array", cut(zarr.Group.create_array))
        patch.setattr(zarr_samples, "put", cut(zarr_samples.put))
        assert run(*words, tmp_path / "d") == 130
    assert run(*words, tmp_path / "d", "--resume") == 0
    assert files(tmp_path / "d") == files(tmp_path / "whole")


@pytest.mark.skipif(os.name == "nt" or sys.platform == "darwin", reason="names are text there")
def test_webdataset_leaves_out_a_mesh_whose_name_is_no_text(shapes, tmp_path, capsys):
    place = tmp_path / "in"
    place.mkdir()
    content = (shapes / "02691156/aa/models/model_normalized.obj").read_bytes()
    for name in (b"a.obj", b"latin\xe4.obj"):
        (place / os.fsdecode(name)).write_bytes(content)
    for more in ((), ("--resume",)):
        assert run(place, "-o", tmp_path / "d", "--layout", "webdataset", *more) == 2
        assert "1 of 2 meshes failed" in capsys.readouterr().err
    assert (tmp_path / "d/samples-000000.left-out.lst").read_bytes() == b"latin\xe4\n"


@pytest.mark.skipif(os.name == "nt", reason="no such names there")
@pytest.mark.parametrize("layout", ["occupancy", "webdataset"])
def test_a_name_of_two_lines_is_refused_by_lists_of_lines(layout, shapes, tmp_path, capsys):
    (tmp_path / "in").mkdir()
    shutil.copy(shapes / "02691156/aa/models/model_normalized.obj", tmp_path / "in" / "new\nline.obj")
    assert run(tmp_path / "in", "-o", tmp_path / "d", "--layout", layout) == 2
    said = f"sdm: the layout {layout} lists meshes line by line, and 'new\\nline' has two lines: rename it\n"
    assert capsys.readouterr().err == said
    assert not (tmp_path / "d").exists()
    assert run(tmp_path / "in", "-o", tmp_path / "d") == 0
