"""Settings of maps as `sdm compute` makes them."""

from __future__ import annotations

import torch

from sdm.cli.maps.map_settings import Settings


def map_settings(resolution: int, **more: object) -> Settings:
    """Those of maps of closed meshes on a CPU, with a margin of a twentieth."""
    return Settings(
        resolution=resolution,
        spacing=None,
        like=None,
        like_image=None,
        margin=0.05,
        device=torch.device("cpu"),
        orient="keep",
        resume=False,
        **more,
    )
