"""A saved design is the design: its numbers, its controller, its runs; and what was changed by hand is noticed."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from base64 import b64decode
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from tests import workspaces
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf import report
from flexhinf.cli import main
from flexhinf.designs import Design, StoredReport, known_design, numbers_schema, read_request

#: Designs of an arm of one joint, of a pose and of a small workspace.
QUICK: dict[str, dict[str, Any]] = {
    "pose": {
        "pose": "30deg", "start": "0", "preset": "damped", "degrees": "2", "draws": 0, "rays": 0, "proof_seconds": 0.0,
    },
    "workspace": {"workspace": ((0.0, 0.5),), "draws": 1},
}  # fmt: skip


#: A picture in a notebook: its drawing, and its caption.
PICTURE = re.compile(r'base64,([^"]*)"><figcaption>(.*?)</figcaption>')


@pytest.fixture(scope="module", params=QUICK)
def saved(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Design, Path]]:
    """A design as it was made, and the folder that it was saved in."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FLEXHINF_OPTIMISATION", "0")
        workspaces.few(patch, POSES=3, GOALS=2, CHOSEN_POSES=2, MODAL_POSES=10, BANDWIDTHS=(14.0,))
        design = fh.design(fh.load_robot("paper"), fh.Specification(**QUICK[request.param]))
        yield design, design.save(tmp_path_factory.mktemp(request.param) / "arm")


@pytest.fixture
def folder(saved: tuple[Design, Path], tmp_path: Path) -> Path:
    """A copy of the folder, which a test may change."""
    return Path(shutil.copytree(saved[1], tmp_path / "arm"))


@pytest.mark.ci("whole designs, their runs and campaigns")
def test_a_saved_design_has_all_names_and_every_bit(saved: tuple[Design, Path], tmp_path: Path) -> None:
    made, folder = saved
    read = fh.load_design(folder)
    assert (read.robot, read.specification.measured) == (made.robot, made.specification.measured)
    assert read.requirements == made.requirements
    assert (read.met, read.missed, read.judgement) == (made.met, made.missed, made.judgement)
    read.controller().save(tmp_path / "controller")
    assert (tmp_path / "controller").read_bytes() == (folder / "controller").read_bytes()
    np.testing.assert_array_equal(read.poles(), made.poles())
    assert read.margins().delay_margin_s == made.margins().delay_margin_s
    for run, again in ((made.move(), read.move()), (made.step(), read.step())):
        for name, values in run.signals.items():
            np.testing.assert_array_equal(again.signals[name], values)
    assert read.campaign(2, seed=3).equals(made.campaign(2, seed=3))
    copy = fh.load_design(read.save(tmp_path / "elsewhere" / "copy"))
    assert copy.requirements == made.requirements
    assert (tmp_path / "elsewhere" / "copy" / "index.html").read_bytes() == (
        folder / "index.html"
    ).read_bytes()
    assert isinstance(copy.evidence, StoredReport)
    assert "copy" in repr(copy)
    shown = [PICTURE.findall(design._repr_html_().replace("\xa0", " ")) for design in (made, read)]
    assert [caption for _, caption in shown[1]] == [caption for _, caption in shown[0]] != []
    for (drawing, _), (again, _) in zip(*shown, strict=True):
        lines = [
            re.findall(r'<path [^>]*\bd="([^"]*)"', b64decode(text).decode()) for text in (drawing, again)
        ]
        assert lines[0] == lines[1]


@pytest.mark.nightly("a comparison and a proof of designs that other tests share")
def test_a_saved_design_is_compared_and_proved(saved: tuple[Design, Path]) -> None:
    read = fh.load_design(saved[1])
    compared = read.compare(["pid"], gains={"pid": {"bandwidth": 12.0}})
    assert [row.name for row in compared.compared] == ["design", "pid"]
    certificate = read.certificate()
    assert getattr(certificate, "is_proved", None) or certificate.check().proved  # type: ignore[union-attr]


@pytest.mark.ci("whole designs, and one anew")
@pytest.mark.parametrize("name", ["design.toml", "design.json", "controller"])
def test_a_folder_that_was_changed_is_noticed_and_the_command_makes_it_anew(
    name: str, saved: tuple[Design, Path], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = folder / name
    file.write_bytes(file.read_bytes().replace(b"30deg", b"31deg") + b"\n")
    with refused_with(fh.InvalidInput, name, "flexhinf design", "arm-new") as refusal:
        fh.load_design(folder)
    assert known_design(read_request(folder / "design.toml")) is None
    if name == "controller":  # its command is followed once
        words = shlex.split(re.split(r", which", refusal.value.advice)[0])
        monkeypatch.chdir(folder.parent)
        assert main(words[1:]) in (0, 1)
        assert fh.load_design(folder.with_name("arm-new")).requirements == saved[0].requirements


@pytest.mark.ci("whole designs, which other tests share")
def test_numbers_that_contradict_the_design_file_are_noticed(folder: Path) -> None:
    """Also where the digests were made to fit."""
    numbers = json.loads((folder / "design.json").read_text(encoding="utf-8"))
    rows = numbers["requirements"]
    rows[0]["found"] = 1.5 * rows[0]["found"] + 1.0
    other = written_as(folder, numbers, (folder / "design.toml").read_text(encoding="utf-8"))
    with refused_with(fh.InvalidInput, "design.json", rows[0]["what"]):
        fh.load_design(other)


def written_as(folder: Path, numbers: dict[str, Any], text: str) -> Path:
    """The report of a folder with other numbers and another design file, whose digests fit."""
    files = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    del files["flexhinf-report.json"]
    changed = {"design.json": json.dumps(numbers), "design.toml": text}
    return report.write(folder.with_name("other"), files | changed)


@pytest.mark.ci("whole designs, which other tests share")
@pytest.mark.parametrize(
    ("change", "told"), [({"version": 1}, "version 1"), ({"law": "pd"}, "another design")]
)
def test_numbers_of_another_version_or_design_are_refused(
    change: dict[str, Any], told: str, folder: Path
) -> None:
    numbers = json.loads((folder / "design.json").read_text(encoding="utf-8")) | change
    text = (folder / "design.toml").read_text(encoding="utf-8")
    with refused_with(fh.InvalidInput, told, "flexhinf design"):
        fh.load_design(written_as(folder, numbers, text))


@pytest.mark.ci("whole designs, which other tests share")
def test_the_numbers_are_of_the_published_schema(saved: tuple[Design, Path]) -> None:
    numbers = json.loads((saved[1] / "design.json").read_text(encoding="utf-8"))
    jsonschema.validate(numbers, numbers_schema())
    design = saved[0]
    assert [row["what"] for row in numbers["requirements"]] == [line.what for line in design.requirements]
    assert (numbers["met"], numbers["law"]) == (design.met, design.specification.law)
    for row in numbers["runs"]:
        assert row["file"] is None or (saved[1] / row["file"]).is_file()


@pytest.mark.ci("whole designs, which other tests share")
def test_a_file_without_its_report_is_refused(folder: Path) -> None:
    (folder / "flexhinf-report.json").unlink()
    with refused_with(fh.InvalidInput, "design.toml", "flexhinf design"):
        fh.load_design(folder / "design.toml")


@pytest.mark.ci("a whole design for a workspace")
def test_a_robot_with_other_numbers_is_saved_beside_its_design(
    saved: tuple[Design, Path], tmp_path: Path
) -> None:
    design = saved[0]
    stiffer = design.robot.with_values({"stiffness": 1.1 * design.robot.nominal["stiffness"]})
    changed = replace(design, robot=stiffer)
    once = fh.load_design(changed.save(tmp_path / "report"))
    assert once.robot.nominal == stiffer.nominal
    twice = fh.load_design(once.save(tmp_path / "again"))  # with a file of its own
    assert (tmp_path / "again" / "robot.toml").is_file()
    assert twice.robot.nominal == stiffer.nominal
    made_in_code = replace(design, robot=replace(stiffer, file=None))
    with refused_with(fh.InvalidInput, "design.toml"):
        fh.load_design(made_in_code.save(tmp_path / "without"))
