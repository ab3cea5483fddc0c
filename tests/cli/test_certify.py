"""``flexhinf certify``: a design's certificate, its check, the theorem in words, and exit codes for scripts."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from tests.certify.a_cubic import CUBIC
from tests.refusals import unnamed

from flexhinf.certify import Certificate, load_certificate
from flexhinf.cli import main
from flexhinf.cli.commands import run


def test_the_theorem_is_said_with_its_hypotheses_and_what_is_not_proved(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    CUBIC.save(tmp_path / "certificate.json")
    assert run(["certify", "--check", str(tmp_path / "certificate.json"), "--verbose"]) == 0
    out = capsys.readouterr().out
    names = (
        "softening", "[0.5, 1] N/m3", "gust [N]", "0.499", "at rest", "continuous time", "gamma = 2.0", "V <= 0.1249",
        "Not proved", "saturation", "no decay", "PROVED again",
    )  # fmt: skip
    assert unnamed(out, *names) == []


def test_the_folder_of_a_certificate_is_checked_as_its_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    CUBIC.save(tmp_path / "certificate.json")
    assert run(["certify", "--check", str(tmp_path)]) == 0
    assert "PROVED again" in capsys.readouterr().out
    (tmp_path / "empty").mkdir()
    assert main(["certify", "--check", str(tmp_path / "empty")]) == 2
    assert "empty/certificate.json" in capsys.readouterr().err


def test_every_cell_is_proved_twice_where_that_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(tmp_path / "certificate.json")
    CUBIC.save(Path(file))
    assert run(["certify", "--check", file, "--every-cell"]) == 0
    assert "Every one" in capsys.readouterr().out
    replace(CUBIC, level=0.1251, starts=()).save(Path(file))
    assert run(["certify", "--check", file, "--every-cell"]) == 1
    assert main(["certify", "paper", "--every-cell"]) == 2
    assert "--every-cell with --check FILE" in capsys.readouterr().err


@pytest.mark.parametrize(
    "changed",
    [
        replace(CUBIC, level=0.1251, starts=()),
        replace(CUBIC, decay=0.01),
        replace(CUBIC, starts=(replace(CUBIC.starts[0], amplitude=0.5),)),
    ],
)
def test_what_is_not_proved_has_exit_code_1(
    changed: Certificate, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed.save(tmp_path / "certificate.json")
    assert run(["certify", "--check", str(tmp_path / "certificate.json")]) == 1
    assert "NOT PROVED: " in capsys.readouterr().out


def test_a_decay_bounds_persistent_disturbances(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    replace(CUBIC, decay=0.25, level=0.06, starts=()).save(tmp_path / "certificate.json")
    assert run(["certify", "--check", str(tmp_path / "certificate.json"), "--verbose"]) == 0
    out = capsys.readouterr().out
    assert "|d(t)| <= 0.0866025 N" in out
    assert "path 1" not in out


def test_a_file_that_is_no_certificate_is_a_mistake(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "c.json").write_text('{"format": "flexhinf certificate", "version": 1, "gamma": NaN}')
    assert run(["certify", "--check", str(tmp_path / "c.json")]) == 2
    assert "c.json" in capsys.readouterr().err


DESIGN = """[design]
robot = "paper"
pose = [3.141592653589793]
penalty = [75, 27, 90, 27, 330]
effort = 10
checked_penalty = [60, 0, 0, 0, 300]
gamma_ratio = 1.5
checked_gamma_ratio = 1.6
degrees = [2, 4]
"""


@pytest.mark.ci("proves a region of degree 2, and checks it twice")
def test_a_design_is_certified_and_its_certificate_checked(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "design.toml").write_text(DESIGN.replace("[2, 4]", "[2]"), encoding="utf-8")
    assert main(["certify", "design.toml", "--degree", "2"]) == 0
    shown = capsys.readouterr().out
    for text in (
        "sampled, %",
        " 99.9 ",
        "V smallest",
        "1.49 rad",  # as the pose is stated
        "nominal parameters",
    ):
        assert text in shown, text
    assert sorted(path.name for path in folder.iterdir()) == ["design.toml", "flexhinf-certificate"]
    written = folder / "flexhinf-certificate"
    assert sorted(path.name for path in written.iterdir()) == [
        "certificate.json",
        "flexhinf-report.json",
        "index.html",
    ]
    certificate = load_certificate(written / "certificate.json")
    assert unnamed(certificate.about, "paper", "3.14159 rad", "degree 2") == []
    replace(certificate, level=1.002 * certificate.level, starts=()).save(folder / "more.json")
    assert main(["certify", "--check", "more.json"]) == 1
    assert "NOT PROVED: " in capsys.readouterr().out
    assert main(["certify", "--check", "flexhinf-certificate/certificate.json"]) == 0
    assert "PROVED again" in capsys.readouterr().out


@pytest.mark.nightly("the certificate of degree 4, which the one of degree 2 above is like")
def test_a_certificate_is_proved_again(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "design.toml").write_text(DESIGN, encoding="utf-8")
    assert main(["certify", "design.toml", "--degree", "4", "--out", "four"]) == 0
    assert main(["certify", "--check", "four/certificate.json"]) == 0
    assert "PROVED again" in capsys.readouterr().out
    content = json.loads((folder / "four" / "certificate.json").read_text(encoding="utf-8"))
    assert content["format"] == "flexhinf certificate"


#: One degree of V, and weights that no search changes.
STATED = ("paper", "--pose", "90deg", "--preset", "paper", "--degrees", "2")


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["certify"], ("--check FILE",)),
        (["certify", "--check", "certificate.json", "--tolerances"], ("--check", "--tolerances")),
        (["certify", "--check", "certificate.json", "--pose", "0"], ("--check", "--pose")),
        (["certify", "paper", "--out", "."], ("flexhinf-report",)),
        (["certify", "paper", "--out", "arm.toml"], ("arm.toml",)),
        (
            ["certify", "paper", "--pose", "0", "--start", "0.1", "--decay", "nan"],
            ("1/s", "nan"),
        ),
        (["certify", "paper", "--check", "certificate.json"], ("'paper'",)),
        pytest.param(
            ["certify", "paper", "--pose", "90deg", "--degrees", "2"],
            ("no margin", "direction"),
            marks=pytest.mark.ci("searches weights"),
        ),
        (
            ["certify", "planar-two-link", "--pose", "home", "--degrees", "2"],
            ("flexhinf design planar-two-link", "--degrees 2"),
        ),
        (["certify", *STATED, "--start", "0"], ("--start", "no effect")),
        (["certify", *STATED, "--peak-effort", "30"], ("--peak-effort", "no effect")),
        (["certify", *STATED, "--quantisation", "1e-4"], ("--quantisation", "no effect")),
        (
            [
                "certify",
                "paper",
                "--pose",
                "90deg",
                "--degrees",
                "2",
                "--damping",
                "0.3",
                "--set",
                "shaping=quintic",
            ],
            ("--set shaping", "no effect"),
        ),
        (
            ["certify", "paper", "--pose", "home", "--tolerances", "--observer", "10"],
            ("--tolerances", "--observer"),
        ),
        (
            ["certify", "paper", "--pose", "home", "--tolerances", "--decay", "0.1"],
            ("--tolerances", "--decay"),
        ),
        (["certify", "arm.toml", "--pose", "home", "--tolerances"], ("'arm'", "tolerances")),
        pytest.param(
            ["certify", "paper", "--pose", "180deg", "--degrees", "2", "--tolerances"],
            ("corner", "tolerances", "γ"),
            marks=pytest.mark.ci("searches weights for all corners"),
        ),
        pytest.param(
            ["certify", "paper", "--pose", "90deg", "--degrees", "4", "--tolerances"],
            ("--preset proved",),
            marks=pytest.mark.ci("searches weights, and a proof of degree 4"),
        ),
        (["certify", "--check", "missing.json"], ("missing.json",)),
    ],
)
def test_what_cannot_be_certified_is_told_and_nothing_is_written(
    folder: Path, arm: str, capsys: pytest.CaptureFixture[str], words: list[str], names: tuple[str, ...]
) -> None:
    (folder / "arm.toml").write_text(arm, encoding="utf-8")
    assert main(words) == 2
    assert unnamed(capsys.readouterr().err, *names) == []
    assert [path.name for path in folder.iterdir()] == ["arm.toml"]


@pytest.mark.ci("proves a step for a box of parameters, twice")
def test_a_step_is_proved_for_all_tolerances_and_checked(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "--pose",
        "90deg",
        "--start",
        "80deg",
        "--preset",
        "damped",
        "--degrees",
        "2",
        "--damping",
        "0.4",
    ]
    assert main(["certify", "paper", *words, "--tolerances"]) == 0
    shown = capsys.readouterr().out
    assert unnamed(shown, "all parameters", "tolerances", "10.0°", "stated box", "input") == []
    given = load_certificate(folder / "flexhinf-certificate" / "certificate.json")
    assert given.step_amplitude == pytest.approx(0.1745, abs=1e-4)
    assert {p.name for p in given.parameters if p.low < p.high} >= {"mass", "stiffness", "resistance"}
    page = (folder / "flexhinf-certificate" / "index.html").read_text(encoding="utf-8")
    assert unnamed(page, "all robots", "stated box") == []
    assert "½∫vᵀR2v" not in page  # the square does not complete where kt/R is uncertain
    assert given.check(threads=2).proved


@pytest.mark.nightly("an observer by the command; tests/certify proves observers")
def test_an_observer_is_proved_and_shown(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "design.toml").write_text(DESIGN, encoding="utf-8")
    assert main(["certify", "design.toml", "--degree", "2", "--observer", "10"]) == 0
    assert "observer" in capsys.readouterr().out
    given = load_certificate(folder / "flexhinf-certificate" / "certificate.json")
    assert given.feedback == "output injection observer"
    page = (folder / "flexhinf-certificate" / "index.html").read_text(encoding="utf-8")
    assert unnamed(page, "observer", "estimates") == []
    assert main(["certify", "--check", "flexhinf-certificate/certificate.json"]) == 0
