"""The registry of formats: readers that other packages bring."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import parhelion as ph
from parhelion import io


def install(monkeypatch: pytest.MonkeyPatch, module: ModuleType | None, value: str) -> None:
    """An entry point of another package for files that end in .vox."""
    if module is not None:
        monkeypatch.setitem(sys.modules, value, module)
    points = [EntryPoint(".vox", value, io.ENTRY_POINTS)]

    def listed(**asked: Any) -> list[EntryPoint]:
        assert asked == {"group": "parhelion.formats"}
        return points

    monkeypatch.setattr("importlib.metadata.entry_points", listed)


def reader(**names: Any) -> ModuleType:
    module = ModuleType("voxels")
    for name, value in names.items():
        setattr(module, name, value)
    return module


def test_a_reader_of_another_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def load(path: Path, options: io.LoadOptions) -> ph.Scene:
        count = int(path.read_text())
        return ph.Scene(
            [ph.Spheres([[2.0 * i, 0, 0] for i in range(count)])],
            background=None,
            name=f"frame {options.frame}",
        )

    voxels = reader(NAME="voxels", OPTIONS=("frame",), BARE=True, load=load)
    install(monkeypatch, voxels, "voxels_for_tests")
    path = tmp_path / "a.VOX"
    path.write_text("3")
    scene = ph.load(path, ph.LoadOptions(frame=2, ground=True))
    assert scene.name == "frame 2"
    assert [s.name for s in scene.shapes] == ["spheres", "key light", "ground"]
    with pytest.raises(ph.FormatError, match="the option 'radius' is not for voxels files"):
        ph.load(path, ph.LoadOptions(radius=1.0))


def test_readers_that_are_broken(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "a.vox"
    path.write_text("3")
    install(monkeypatch, None, "no_such_module_at_all")
    with pytest.raises(ph.FormatError, match="'no_such_module_at_all' cannot be imported"):
        ph.load(path)
    install(monkeypatch, reader(NAME="voxels", OPTIONS=()), "voxels_for_tests")
    with pytest.raises(ph.FormatError, match="the reader 'voxels_for_tests' has no load"):
        ph.load(path)
    other = tmp_path / "a.voxx"
    other.write_text("3")
    with pytest.raises(ph.FormatError, match=r"unknown file ending '.voxx'; did you mean '.vox'"):
        ph.load(other)
