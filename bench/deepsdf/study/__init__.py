"""DeepSDF on left atria, held to the standard of a reviewer: `python -m sdm.bench.deepsdf.study`."""
