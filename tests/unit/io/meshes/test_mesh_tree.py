"""Mesh files of a folder: none is left out without a word."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import trimesh

from sdm.cli import main
from sdm.errors import MeshError
from sdm.io import mesh_tree
from sdm.io.meshes.mesh_tree import placed_meshes


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A mesh, another one in a folder."""
    place = tmp_path / "in"
    (place / "sub").mkdir(parents=True)
    for name in ("a.ply", "sub/b.ply"):
        trimesh.creation.icosphere(1).export(place / name)
    return place


def test_links_that_lead_nowhere_are_told_of(folder, tmp_path, capsys):
    (folder / "gone.ply").symlink_to("nowhere.ply")
    (folder / "loop.ply").symlink_to("loop.ply")
    os.mkfifo(folder / "pipe.ply")
    assert [path.name for path in mesh_tree(folder)] == ["a.ply", "gone.ply", "loop.ply", "b.ply"]
    words = ["compute", str(folder), "-o", str(tmp_path / "out"), "--resolution", "6", "--format", "npz"]
    assert main([*words, "--device", "cpu"]) == 2
    said = capsys.readouterr().err.splitlines()
    assert said[-3] == f"sdm: {folder / 'gone.ply'} is a link to nowhere.ply, which is not there"
    assert said[-2].startswith(f"sdm: {folder / 'loop.ply'} cannot be read: Too many levels of symbolic links")
    assert said[-1] == "sdm: 2 of 4 meshes failed; the others are done"


def test_a_folder_that_cannot_be_read_is_refused(folder, monkeypatch):
    plain = os.scandir

    def guarded(place: str) -> object:
        if Path(place).name == "sub":
            raise PermissionError(13, "Permission denied", str(place))
        return plain(place)

    monkeypatch.setattr(os, "scandir", guarded)
    with pytest.raises(MeshError, match=rf"the folder {folder}/sub cannot be read \(Permission denied\), and its"):
        mesh_tree(folder)


def test_a_folder_whose_names_alone_can_be_read_is_refused(folder, monkeypatch):
    plain = os.access
    monkeypatch.setattr(os, "access", lambda place, mode: Path(place).name != "sub" and plain(place, mode))
    with pytest.raises(MeshError, match=rf"the folder {folder}/sub cannot be read \(Permission denied\), and its"):
        mesh_tree(folder)


def test_a_link_to_a_folder_is_followed_once(folder):
    (folder / "again").symlink_to("sub")
    (folder / "sub" / "up").symlink_to(folder)
    (folder / ".hidden").mkdir()
    (folder / ".hidden" / "c.ply").touch()
    places = [place.as_posix() for _, place in placed_meshes(folder)]
    assert places == ["a.ply", "again/b.ply"]
    assert mesh_tree(folder / "sub" / "..") == [folder / "sub" / ".." / "a.ply", folder / "sub" / ".." / "again/b.ply"]
