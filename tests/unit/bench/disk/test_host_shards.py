"""The measurement of the host's share of writing shards."""

from sdm.bench.disk.host_shards import Options, rows


def test_a_row_for_each_type_and_number_of_threads(tmp_path):
    found = rows(Options(maps=3, shards=2, resolution=8, threads=(1, 2), rounds=1, folder=tmp_path))
    assert [(row["maps"], row["threads"]) for row in found] == [
        ("float16 none", 1),
        ("float16 none", 2),
        ("float32 zstd", 1),
        ("float32 zstd", 2),
    ]
    assert all(row["cpu_ms"] > 0 and row["per_second"] > 0 for row in found)
    assert not list(tmp_path.iterdir())
