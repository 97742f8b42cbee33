"""Plans of dense queries: what the cost model decides, and what options decide instead, in their context alone."""

from __future__ import annotations

import threading
from dataclasses import FrozenInstanceError, replace

import pytest

from sdm.engine.plan_override import OPTIONS, plan_override
from sdm.kernels.bvh.tree import depth_for
from sdm.kernels.dense.chunk_pool import CHUNK
from sdm.kernels.dense.cost_model import MOST_REGIONS, NO_SPLITS
from sdm.kernels.dense.plan import Plan, Workload, joint_plan, make_plan
from sdm.kernels.plan_options import PlanOptions

USUAL = PlanOptions()
GPU = 80 << 30


def workload(triangles: int = 20_000, shape: tuple[int, int, int] = (128, 128, 128), meshes: int = 1) -> Workload:
    return Workload(triangles, depth_for(triangles), meshes, shape, (0.01, 0.01, 0.01), turned=False)


def test_a_plan_says_what_follows_from_it():
    plan = make_plan(workload(meshes=3), GPU, USUAL)
    assert plan.method == "cells"
    assert plan.regions == (128 // (2 * plan.cell),) * 3
    assert plan.total == 3 * (128 // (2 * plan.cell)) ** 3
    assert plan.most * plan.passes >= plan.total
    assert plan.blocks >= 8 * plan.most
    with pytest.raises(FrozenInstanceError):
        plan.cell = 4  # type: ignore[misc]


def test_a_plan_is_made_once():
    assert make_plan(workload(), GPU, USUAL) is make_plan(workload(), GPU, PlanOptions())


@pytest.mark.parametrize("memory", [None, GPU])
def test_slabs_of_a_grid_are_planned_alike(memory):
    plans = [make_plan(workload(500_000, (layers, 128, 128)), memory, USUAL) for layers in (32, 64, 128)]
    alike = {(p.method, p.cell, p.region_shares, p.cell_shares, p.levels_left_out) for p in plans}
    assert len(alike) == 1


def test_a_cpu_has_one_group_for_each_list():
    plan = make_plan(workload(), None, USUAL)
    assert (plan.region_shares, plan.cell_shares, plan.split_length) == (1, 1, NO_SPLITS)
    assert plan.passes == 1


@pytest.mark.parametrize("memory", [None, GPU])
@pytest.mark.parametrize(
    ("options", "decided"),
    [
        ({"method": "search"}, {"method": "search"}),
        ({"cell": 16}, {"cell": 16, "regions": (4, 4, 4)}),
        ({"shares": (8, 4)}, {"region_shares": 8, "cell_shares": 4}),
        ({"split_length": 7}, {"split_length": 7}),
        ({"cell": 16, "by_brick": True, "list_split": 5}, {"by_brick": True, "list_split": 5, "block_shares": 1}),
        ({"cell": 16, "by_brick": False}, {"by_brick": False}),
        ({"cell": 8, "by_brick": True}, {"by_brick": False}),
        ({"levels_left_out": 2}, {"levels_left_out": 2}),
        ({"levels_left_out": 99}, {"levels_left_out": depth_for(20_000)}),
        ({"pool_entries": 1 << 22}, {"chunks": (1 << 22) // CHUNK}),
        ({"most_regions": 10, "cell": 8}, {"passes": 52, "most": 10}),
        ({"most_columns": 9}, {"most_columns": 9}),
    ],
)
def test_options_decide(memory, options, decided):
    plan = make_plan(workload(), memory, replace(USUAL, **options))
    assert {name: getattr(plan, name) for name in decided} == decided


@pytest.mark.parametrize(("triangles", "splits"), [(12, False), (500, False), (640, True), (20_000, True)])
def test_lists_are_split_only_where_one_may_be_long_enough(triangles, splits):
    work = workload(triangles, (64, 64, 64))
    plan = make_plan(work, GPU, USUAL)
    assert (plan.split_length < NO_SPLITS) == splits
    assert splits == (plan.split_length < 1 << (work.depth - plan.levels_left_out))
    # Of several the largest tree says whether there are any.
    others = [work, workload(100, (64, 64, 64))]
    joint = joint_plan(others, [make_plan(other, GPU, USUAL) for other in others], GPU, USUAL)
    assert (joint.split_length < NO_SPLITS) == (joint.split_length < 1 << work.depth)


def test_meshes_planned_together_have_lists_by_brick_if_any_has():
    """Of cells of 16^3 voxels: those of the smaller mesh would be measured from one list."""
    works = [workload(triangles, (256, 256, 256)) for triangles in (1_000, 20_000)]
    plans = [make_plan(work, GPU, USUAL) for work in works]
    assert [(plan.cell, plan.by_brick) for plan in plans] == [(16, False), (16, True)]
    for order in (1, -1):
        joint = joint_plan(works[::order], plans[::order], GPU, USUAL)
        assert joint.by_brick
        assert joint.blocks > 8 * joint.most
        assert joint.block_shares == 1


def test_no_pass_has_more_regions_than_can_be_numbered():
    plan: Plan = make_plan(workload(100, (1024, 1024, 1024)), GPU, PlanOptions(most_regions=1 << 30, cell=8))
    assert plan.most <= MOST_REGIONS


@pytest.mark.parametrize("wrong", [{"method": "lists"}, {"points_method": "cells"}])
def test_methods_that_there_are_not(wrong):
    with pytest.raises(ValueError, match="not by"):
        PlanOptions(**wrong)


def test_options_hold_in_their_context():
    with plan_override(method="cells", cell=16):
        with plan_override(cell=8):
            assert OPTIONS.get() == PlanOptions(method="cells", cell=8)
        assert OPTIONS.get() == PlanOptions(method="cells", cell=16)
    assert OPTIONS.get() == PlanOptions()


def test_options_are_the_usual_ones_again_after_an_error():
    with pytest.raises(RuntimeError, match="in between"), plan_override(method="search"):
        raise RuntimeError("in between")
    assert OPTIONS.get() == PlanOptions()


def test_options_that_there_are_not():
    with pytest.raises(TypeError, match="no_such_option"), plan_override(no_such_option=1):
        pass
    assert OPTIONS.get() == PlanOptions()


def test_other_threads_plan_as_usual():
    seen: list[PlanOptions] = []
    with plan_override(method="search"):
        other = threading.Thread(target=lambda: seen.append(OPTIONS.get()))
        other.start()
        other.join()
    assert seen == [PlanOptions()]
