"""Names that the page sends stay within the working folder."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.studio.folder import WorkingFolder

DESIGN = '[design]\nrobot = "paper"\npose = "10deg"\n'


@pytest.fixture
def folder(tmp_path: Path) -> WorkingFolder:
    root = tmp_path / "work"
    root.mkdir()
    (tmp_path / "secret.toml").write_text(DESIGN, encoding="utf-8")
    (root / "below").mkdir()
    (root / "design.toml").write_text(DESIGN, encoding="utf-8")
    return WorkingFolder(root)


def test_names_within_are_taken(folder: WorkingFolder) -> None:
    assert folder.check_design("design.toml") == folder.root / "design.toml"
    assert folder.place("design file", " below/new.toml ") == folder.root / "below" / "new.toml"
    assert folder.designs() == ["design.toml"]
    assert folder.free_name("design", ".toml") == "design-2.toml"


@pytest.mark.parametrize(
    "name",
    [
        "../secret.toml", "below/../../secret.toml", "/etc/passwd", "~/x.toml", "C:\\x.toml", "..\\secret.toml", "",
        "a\0b.toml", "x" * 300, "a\nb", None, 3, ["design.toml"], "file:///etc/passwd", "..", "\u202etxt.toml",
    ],
)  # fmt: skip
def test_names_that_lead_out_are_refused(folder: WorkingFolder, name: object) -> None:
    with pytest.raises(InvalidInput):
        folder.place("design file", name)


@pytest.mark.skipif(os.name != "posix", reason="symbolic links need rights there")
def test_links_are_refused(folder: WorkingFolder, tmp_path: Path) -> None:
    (folder.root / "link.toml").symlink_to(tmp_path / "secret.toml")
    (folder.root / "same.toml").symlink_to(folder.root / "design.toml")
    (folder.root / "out").symlink_to(tmp_path)
    for name in ("link.toml", "same.toml", "out/secret.toml"):
        with refused_with(InvalidInput, "working folder", "links"):
            folder.place("design file", name)
    assert folder.designs() == ["design.toml"]


@pytest.mark.parametrize("key", ["robot", "elastic", "move", "workspace"])
def test_files_within_a_design_are_looked_at_too(folder: WorkingFolder, key: str) -> None:
    lines = {"robot": '"paper"', key: '"../secret.toml"'}
    text = "[design]\n" + "".join(f"{name} = {value}\n" for name, value in lines.items())
    (folder.root / "design.toml").write_text(text, encoding="utf-8")
    with refused_with(InvalidInput, key, "secret.toml"):
        folder.check_design("design.toml")


def test_the_links_of_a_robot_are_looked_at_too(folder: WorkingFolder) -> None:
    (folder.root / "arm.toml").write_text('urdf = "../../arm.urdf"\n', encoding="utf-8")
    (folder.root / "design.toml").write_text('[design]\nrobot = "arm.toml"\n', encoding="utf-8")
    with refused_with(InvalidInput, "urdf", "arm.urdf"):
        folder.check_design("design.toml")
