from __future__ import annotations

import numpy as np
import pytest
import trimesh

import sdm

BALL = trimesh.creation.icosphere(2)


def flipped(share: float) -> np.ndarray:
    turn = np.random.default_rng(0).random(len(BALL.faces)) < share
    return np.where(turn[:, None], BALL.faces[:, ::-1], BALL.faces)


def sheets() -> tuple[np.ndarray, np.ndarray]:
    box = trimesh.creation.box()
    return np.asarray(box.triangles).reshape(-1, 3) * [1, 1.1, 1.2] + np.repeat(np.arange(12), 3)[:, None] * 1e-3, (
        np.arange(36).reshape(-1, 3)
    )


CASES = {
    "closed": ((BALL.vertices, BALL.faces), "winding", "closed"),
    "turned faces": ((BALL.vertices, flipped(0.5)), "flood", "orient='parts'"),
    "less a face": ((BALL.vertices, BALL.faces[1:]), "winding", "near the gaps"),
    "doubled": ((BALL.vertices, np.concatenate([BALL.faces, BALL.faces[:, ::-1]])), "flood", "doubled walls"),
    "half": ((BALL.vertices, BALL.faces[BALL.triangles_center[:, 2] < 0]), "none", "one sheet"),
    "sheets": (sheets(), "flood", "shut off an inside"),
}


@pytest.mark.parametrize("name", CASES)
def test_a_sign_is_recommended_with_its_reason(name):
    mesh, sign, why = CASES[name]
    report = sdm.inspect_mesh(mesh)
    assert (report.recommended_sign, why in report.recommendation) == (sign, True)
    assert report.as_dict()["recommended_sign"] == sign
