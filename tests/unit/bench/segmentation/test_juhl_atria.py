"""Juhl's comparison on volumes with labels: targets, what chooses rates, tables."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from sdm.bench.segmentation import juhl_atria, report
from sdm.bench.segmentation.juhl_atria import AtriumPatches, enlarged, parts_of
from sdm.bench.segmentation.log_file import LogFile
from sdm.segmentation import Settings
from sdm.segmentation.data.downsample import coarse_image
from tests.helpers.segmentation_cases import case, volume, write_hdf5


@pytest.mark.parametrize("patch", [(8, 8, 8), (16, 16, 8)])
def test_targets_are_distances_from_one_surface(patch):
    """Also of a padded case, whose mesh has to lie where its label does; 26 voxels are no multiple of 3."""
    settings = Settings(method="pwr", architecture="unet", patch=patch, coarsen=3, mirrors="")
    one = case(1, spacing=(1.0, 1.0, 1.0))
    maps, within = {}, None
    for target in ("voxels", "mesh", "coarse"):
        patches = AtriumPatches([one], target, settings, "cpu")
        within, maps[target] = patches._cases[0][1] > 0.5, patches._cases[0][2]
        again = patches.batch(1, seed=0, step=3, augment="none")
        assert again.map is not None
        assert float(again.map.abs().max()) <= 1
    near = maps["voxels"].abs() < 3
    assert near.sum() > 100
    for other, beside in (("mesh", 0.5), ("coarse", 1.0)):
        apart = (maps[other] - maps["voxels"])[near]
        assert apart.abs().mean() < beside
        for slope in torch.gradient(maps["voxels"]):
            # By how many of the image's voxels one lies beside the other along an axis.
            along = slope[near] / 3
            assert abs((apart * along).sum() / along.square().sum()) < 0.3
    # Of voxels that are more than half inside, all but those at the surface are negative.
    sure = maps["mesh"].abs() > 1
    assert torch.equal((maps["mesh"] < 0)[sure], within[sure])


def test_nearest_gives_each_voxel_its_cube_s_label():
    values = torch.randn(9, 8, 7, generator=torch.Generator().manual_seed(0))
    found = enlarged(values, 3, (26, 24, 20), "nearest")
    assert found.shape == (26, 24, 20)
    assert torch.equal(found[1::3, 1::3, 1::3], values[:9, :8, :7] < 0)
    assert torch.equal(coarse_image(found.float(), 3) > 0.5, values < 0)
    linear = enlarged(values, 3, (26, 24, 20), "linear")
    assert torch.equal(linear[1::3, 1::3, 1::3], values < 0)


def test_what_chooses_rates_has_no_twin_among_what_is_trained_on(monkeypatch):
    record = {"names": list("abcdef"), "limit_mm": 1.0}
    apart = [[9.0 * (i != j) for j in range(6)] for i in range(6)]
    apart[1][3] = apart[3][1] = 0.5
    monkeypatch.setattr(juhl_atria, "read_record", lambda: {**record, "distances_mm": apart})
    training, choosing = parts_of([dataclasses.replace(case(0), name=name) for name in "abcdef"])
    assert [c.name for c in choosing] == ["b", "f"]
    assert [c.name for c in training] == ["a", "c", "e"]


def test_a_study_at_tiny_size(tmp_path, monkeypatch, capsys):
    """Rates are tried without the cases that choose them, the best is every seed's, and the tables say what gains."""
    for part, seeds in (("train", (0, 1, 2)), ("val", (3, 4))):
        for seed in seeds:
            write_hdf5(tmp_path / "la" / part / f"case{seed}.h5", *volume(seed))
    logs = tmp_path / "logs.jsonl"
    words = f"x run --data {tmp_path / 'la'} --logs {logs} --work {tmp_path / 'work'} --networks pwc-ce pwr-voxels"
    words += " --rates 0.01 0.03 --seeds 0 1 --steps 2 --patch 16 16 8 --coarsen 2 --filters 2 --gpus 0"
    monkeypatch.setattr("sys.argv", words.split())
    juhl_atria.main()
    by_name = {log["job"]["name"]: log for log in LogFile(logs).trainings()}
    assert len(by_name) == 2 * (2 + 2)
    assert by_name["pwc-ce-rate-0.01"]["scored"] == ["case1"]
    assert by_name["pwc-ce-0"]["scored"] == ["case3", "case4"]
    errors = juhl_atria.rates_of(LogFile(logs), "pwr-voxels")
    best = min(errors, key=errors.__getitem__)
    assert {by_name[f"pwr-voxels-{seed}"]["job"]["settings"]["learning_rate"] for seed in (0, 1)} == {best}
    text = capsys.readouterr().out
    assert "| PWR on the labels' transform, linear (as published) (2) |" in text
    assert "| PWR over PWC (CE), as published |" in text
    none = LogFile(tmp_path / "none.jsonl")
    page = report.page(none, none, none, atria=LogFile(logs))
    assert "### Left atria in place of Juhl's medical data" in page
    assert f"| `pwr-voxels` | {' | '.join(page_rates(errors, best))} |" in page
    juhl_atria.main()
    assert "0 of 8 jobs to do" in capsys.readouterr().out


def page_rates(errors: dict[float, float], best: float) -> list[str]:
    cells = {rate: f"{100 * (1 - error):.2f}" for rate, error in errors.items()}
    return [f"**{cell}**" if cell == cells[best] else cell for _, cell in sorted(cells.items())]


def test_a_wider_grid_trains_those_anew_whose_rate_is_another(tmp_path):
    logs = LogFile(tmp_path / "logs.jsonl")

    def put(network: str, name: str, kind: str, rate: float, **more) -> None:
        job = {"name": f"{network}-{name}", "kind": kind, "network": network, "settings": {"learning_rate": rate}}
        logs.put({"job": job, **more})

    for network, dices in (("pwc", {0.1: 0.9, 0.2: 0.7, 0.3: 0.8}), ("pwr-mesh", {0.1: 0.7, 0.2: 0.9})):
        for rate, dice in dices.items():
            put(network, f"rate-{rate}", "rate", rate, validation={"linear": [{"dice": dice}]})
        put(network, "0", "test", 0.1)
        put(network, "1", "test", 0.3)
    options = juhl_atria.parser().parse_args(["run", "--rates", "0.1", "0.2", "0.3", "--networks", "pwc", "pwr-mesh"])
    options.logs = logs
    juhl_atria.remove_outdated(options)
    # Of pwr-mesh one rate is not tried yet.
    assert {name for name in logs.names() if "rate" not in name} == {"pwc-0", "pwr-mesh-0", "pwr-mesh-1"}


def test_one_rate_is_not_searched_for():
    options = juhl_atria.parser().parse_args(["run", "--rates", "0.1", "--networks", "pwc", "--seeds", "0", "1"])
    assert [job["name"] for job in juhl_atria.jobs(options)] == ["pwc-0", "pwc-1"]
