"""Datasets of signed distance maps: what a stream yields, frozen into a Zarr 3 folder, and read from it."""

from sdm.dataset.generate import generate
from sdm.dataset.reader import SDMDataset
from sdm.dataset.verify import verify

__all__ = ["SDMDataset", "generate", "verify"]
