"""Narrow bands in files: `.npz`, `.zarr` and `.nvdb`."""
