"""Datasets of signed distance maps: what a stream yields, frozen into a Zarr 3 folder, and read from it."""

from sdm.dataset.freeze import freeze
from sdm.dataset.reader import SDMDataset
from sdm.dataset.repair import damaged, verify
from sdm.dataset.writer import generate

__all__ = ["SDMDataset", "damaged", "freeze", "generate", "verify"]
