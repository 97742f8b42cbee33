"""Layouts by name."""

from __future__ import annotations

from sdm.errors import SDMError
from sdm.sampling.layouts.sample_layout import Layout

LAYOUTS = ("deepsdf", "occupancy", "zarr", "webdataset")


def layout_called(name: str, dataset: str) -> Layout:
    """The layout of this name; a dataset's name is part of DeepSDF's paths.

    Raises:
        SDMError: There is none.
    """
    if name == "deepsdf":
        from sdm.sampling.layouts.deepsdf import DeepSDFLayout

        return DeepSDFLayout(dataset)
    if name == "occupancy":
        from sdm.sampling.layouts.occupancy import OccupancyLayout

        return OccupancyLayout()
    if name == "zarr":
        from sdm.sampling.layouts.zarr_samples import ZarrLayout

        return ZarrLayout()
    if name == "webdataset":
        from sdm.sampling.layouts.webdataset import WebDatasetLayout

        return WebDatasetLayout()
    raise SDMError(f"there is no layout called {name!r}; use {', '.join(LAYOUTS)}")
