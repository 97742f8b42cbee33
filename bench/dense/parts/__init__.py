"""Parts of `python -m sdm.bench.dense`: one module each, with `run(job)` and `summary`."""
