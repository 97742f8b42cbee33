"""Archives of meshes: every mesh in them, and no more memory or disk than they may need."""

from __future__ import annotations

import bz2
import gzip
import io
import tarfile
import tracemalloc
import zipfile
from typing import Any

import pytest
import trimesh

from sdm.errors import MeshError
from sdm.inspect import inspect_mesh
from sdm.io import load_mesh
from sdm.io.meshes import archive
from sdm.io.meshes.load import mesh_files

BOX: Any = trimesh.creation.box((1, 2, 3)).export(file_type="stl")
ZEROS = bytes(1 << 24)


@pytest.fixture
def small_budget(monkeypatch):
    monkeypatch.setattr(archive, "ALWAYS_FITS", 1 << 22)


def write_archive(path, files: dict[str, bytes]) -> None:
    if path.suffix == ".zip":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
            for name, content in files.items():
                packed.writestr(name, content)
        return
    if not path.name.endswith((".tar.gz", ".tar.bz2")):
        pack = gzip.compress if path.suffix == ".gz" else bz2.compress
        path.write_bytes(pack(next(iter(files.values()))))
        return
    opened = tarfile.TarFile.gzopen if path.suffix == ".gz" else tarfile.TarFile.bz2open
    with opened(str(path), "w") as packed:
        for name, content in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            packed.addfile(info, io.BytesIO(content))


@pytest.mark.parametrize("name", ["a.zip", "a.tar.gz", "a.tar.bz2", "a.stl.bz2", "a.STL.gz"])
def test_meshes_of_an_archive_are_one(name, tmp_path):
    single = name in ("a.stl.bz2", "a.STL.gz")
    write_archive(tmp_path / name, {"a.stl": BOX} if single else {"a.stl": BOX, "b/c.STL": BOX, "readme.txt": b"x"})
    report = inspect_mesh(load_mesh(tmp_path / name))
    assert report.triangles == (12 if single else 24)
    assert report.bounds == ((-0.5, -1.0, -1.5), (0.5, 1.0, 1.5))


@pytest.mark.parametrize("name", ["a.zip", "a.tar.gz", "a.stl.bz2", "a.stl.gz"])
@pytest.mark.usefixtures("small_budget")
def test_an_archive_of_zeros_is_refused_before_it_is_memory(name, tmp_path):
    write_archive(tmp_path / name, {"a.stl": ZEROS})
    tracemalloc.start()
    try:
        with pytest.raises(MeshError, match=rf"{name} unpacks to more than 4 MiB"):
            load_mesh(tmp_path / name)
        assert tracemalloc.get_traced_memory()[1] < len(ZEROS) / 2
    finally:
        tracemalloc.stop()


def test_compressed_meshes_of_a_folder_are_found_and_other_gz_files_are_not_meshes(tmp_path):
    write_archive(tmp_path / "a.stl.gz", {"a.stl": BOX})
    for name in ("labels.nii.gz", "notes.gz"):
        (tmp_path / name).write_bytes(gzip.compress(b"0"))
    assert [path.name for path in mesh_files(tmp_path)] == ["a.stl.gz"]
    with pytest.raises(MeshError, match="ends like an image"):
        load_mesh(tmp_path / "labels.nii.gz")
    with pytest.raises(MeshError, match=r"no mesh by the ending \.gz"):
        load_mesh(tmp_path / "notes.gz")


@pytest.mark.usefixtures("small_budget")
def test_a_zipped_format_of_zeros(tmp_path):
    pytest.importorskip("lxml")
    write_archive(tmp_path / "a.zip", {"3D/3dmodel.model": ZEROS})
    (tmp_path / "a.zip").rename(tmp_path / "a.3mf")
    with pytest.raises(MeshError, match=r"a\.3mf unpacks to more than 4 MiB"):
        load_mesh(tmp_path / "a.3mf")


def test_a_damaged_mesh_of_an_archive_is_named(tmp_path):
    write_archive(tmp_path / "a.zip", {"good.stl": BOX, "bad.stl": BOX[:-30]})
    with pytest.raises(MeshError, match=r"a\.zip: bad\.stl is cut off .* promises 12 triangles, and 11 are there"):
        load_mesh(tmp_path / "a.zip")


@pytest.mark.parametrize("name", ["../a.stl", "/tmp/sdm-test/a.stl", "b/../../a.stl"])
@pytest.mark.parametrize("kind", ["a.zip", "a.tar.gz"])
def test_files_that_would_lie_outside(kind, name, tmp_path):
    write_archive(tmp_path / kind, {name: BOX})
    with pytest.raises(MeshError, match="would lie outside"):
        load_mesh(tmp_path / kind)


def test_an_archive_without_meshes(tmp_path):
    write_archive(tmp_path / "a.zip", {"readme.txt": b"x"})
    with pytest.raises(MeshError, match="no triangles"):
        load_mesh(tmp_path / "a.zip")
