"""``flexhinf identify``: a robot file with the numbers of a log, a motion for what it does not tell, and the page."""

from __future__ import annotations

import io
import json
import re
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from rich.console import Console
from tests.identification.test_misfit import dry_log
from tests.logs import arm_log, write_log
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.cli import main
from flexhinf.identification.consistency import Consistency, OutputConsistency, SquaredError, whiteness
from flexhinf.pages import IdentifiedRobot
from flexhinf.pages.identify import identified_table, identified_verdict

# One filter for each test, compiled and run once: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

SIGNALS = ("motor_voltage", "link_position", "motor_position")
WORDS = ["identify", "log.csv", "--robot", "wrong.toml", "--measured", "link_position,motor_position"]


@pytest.fixture(scope="module")
def log_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of the paper's arm."""
    return write_log(
        tmp_path_factory.mktemp("log") / "log.csv", SIGNALS, *arm_log(fh.load_robot("paper"), count=1200)
    )


@pytest.fixture
def logged(folder: Path, log_file: Path) -> Path:
    """The log, and a file of the arm with a wrong spring."""
    shutil.copy(log_file, folder)
    arm = fh.load_robot("paper")
    arm.with_values({"stiffness": 70.0, "friction": 0.2}).save(folder / "wrong.toml")
    return folder


@pytest.mark.ci("simulates a log, identifies it, and draws its page")
def test_the_robot_file_has_the_numbers_of_the_log(logged: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*WORDS, "--parameters", "stiffness,friction"]) == 0
    report = logged / "flexhinf-identify"
    assert {"index.html", "identify.json", "robot.toml"} <= {path.name for path in report.iterdir()}
    assert not (report / "motion.csv").exists()
    found = fh.load_robot(report / "robot.toml")
    for name, true in (("stiffness", 100.0), ("friction", 0.1)):
        low, high = found[name].interval
        assert low - (high - low) < true < high + (high - low)
        assert 0.0 < high - low < 0.01 * true
    numbers: dict[str, Any] = json.loads((report / "identify.json").read_text(encoding="utf-8"))
    assert numbers["numbers"]["stiffness"]["identifiable"]
    assert numbers["numbers"]["stiffness"]["stated"] == 70.0
    assert unnamed(capsys.readouterr().out, "stiffness", "friction", "report") == []
    page = (report / "index.html").read_text(encoding="utf-8")
    assert [
        anchor for anchor in ("numbers", "innovations", "signals", "log") if f'id="{anchor}"' not in page
    ] == []


@pytest.mark.ci("identifies a log")
def test_errors_of_the_states_are_no_misfit_of_the_innovations(folder: Path) -> None:
    """A filter whose model is found without disturbances trusts it more than its numbers deserve."""
    arm = fh.load_robot("paper")
    true = arm_log(arm, count=1500, noise=0.0)[2] + 1e-4
    names = (*SIGNALS, "state.link_position", "state.motor_position")
    write_log(folder / "log.csv", names, *arm_log(arm, count=1500), true)
    arm.with_values({"stiffness": 70.0}).save(folder / "wrong.toml")
    assert main([*WORDS, "--parameters", "stiffness"]) == 0
    numbers = json.loads((folder / "flexhinf-identify" / "identify.json").read_text(encoding="utf-8"))
    assert not any(re.search(r"not\s+fit", text) for text in numbers["says"])


@pytest.mark.ci("proposes a motion")
def test_what_the_log_does_not_tell_stays_and_a_motion_is_proposed(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    y = 1e-4 * rng.normal(size=(400, 2))
    write_log(folder / "log.csv", SIGNALS, 1e-3 * np.arange(400), np.zeros(400), y)
    fh.load_robot("paper").save(folder / "wrong.toml")
    assert main([*WORDS, "--parameters", "stiffness", "--motion", "3"]) == 1
    report = folder / "flexhinf-identify"
    assert fh.load_robot(report / "robot.toml")["stiffness"] == fh.load_robot("paper")["stiffness"]
    numbers = json.loads((report / "identify.json").read_text(encoding="utf-8"))
    assert not numbers["numbers"]["stiffness"]["identifiable"]
    assert numbers["motion"]["standard_errors"]["stiffness"] < 0.05
    assert len((report / "motion.csv").read_text(encoding="utf-8").splitlines()) > 100
    assert unnamed(capsys.readouterr().out, "stiffness") == []


@pytest.mark.ci("simulates dry friction by SciPy, and identifies twice")
def test_a_model_that_does_not_fit_is_a_result_of_its_own(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A log with dry friction that the robot's file states and the model leaves out, and the same with it."""
    arm = fh.load_robot("paper")
    write_log(folder / "log.csv", SIGNALS, *dry_log(arm))
    text = arm.file.read_text(encoding="utf-8") if arm.file else ""
    dry = text.replace("[joint.motor]", "[joint.motor]\ncoulomb_friction = 1.0").replace(
        "0.1, tolerance = 15", "0.2"
    )
    (folder / "wrong.toml").write_text(dry.replace("inductance", "# inductance"), encoding="utf-8")
    assert main([*WORDS, "--parameters", "friction"]) == 1
    report = folder / "flexhinf-identify"
    shown = capsys.readouterr().out
    assert unnamed(shown, "innovations", "--extras coulomb_friction", "friction") == []
    assert max(map(len, shown.splitlines()[:-1])) <= 80
    assert len(shown.splitlines()) <= 26
    assert "not fit" in fh.load_robot(report / "robot.toml")["friction"].source
    assert not json.loads((report / "identify.json").read_text(encoding="utf-8"))["model_fits"]
    page = (report / "index.html").read_text(encoding="utf-8")
    assert unnamed(page, "--extras coulomb_friction", "risky") == []
    assert main([*WORDS, "--parameters", "friction", "--extras", "coulomb_friction", "--out", "dry"]) == 0
    assert "coulomb_friction" not in capsys.readouterr().out
    found = fh.load_robot(folder / "dry" / "robot.toml")["friction"]
    assert found.interval[0] < 0.1 < found.interval[1]
    assert "not fit" not in found.source


@pytest.mark.ci("identifies three numbers of a log")
@pytest.mark.parametrize("command", ["identify", "estimate"])
def test_an_ending_fits_a_screen_and_names_what_the_model_leaves_out(
    folder: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The paper's file states an inductance; names are whole words, whatever their length."""
    arm = fh.load_robot("paper")
    write_log(folder / "log.csv", SIGNALS, *arm_log(arm, count=1000))
    arm.save(folder / "wrong.toml")
    names = ["--parameters", "stiffness,motor_inertia,back_emf_constant"] if command == "identify" else []
    main([command, *WORDS[1:], *names])
    shown = capsys.readouterr().out
    assert unnamed(shown, "--extras inductance") == []
    lines = shown.splitlines()
    assert max(map(len, lines[:-1])) <= 80
    assert len(lines) <= 25
    assert "…" not in shown


FILTERED: Any = SimpleNamespace(findings=(), log=SimpleNamespace(columns={}))


def correlated() -> Consistency:
    """What innovations say that follow each other."""
    test = whiteness(np.repeat(np.random.default_rng(0).normal(size=100), 3))
    output = OutputConsistency("motor_position", "rad", 300, 1.0, 1.0, 1.0, 0.0, 0.95, test)
    return Consistency((output,), SquaredError(1.5, (0.9, 1.1), 300, 300), None)


@pytest.mark.parametrize("share", [0.3, 1e-2, 1e-4, 1e-6])
def test_both_ends_of_an_interval_are_told_apart(share: float) -> None:
    robot, names = fh.load_robot("paper"), ("stiffness", "friction")
    intervals = {
        name: (robot[name].value * (1.0 - share), robot[name].value * (1.0 + share)) for name in names
    }
    found: Any = SimpleNamespace(
        names=names, hidden=(), consistent=True, values={name: robot[name].value for name in names},
        standard_errors=dict.fromkeys(names, share), intervals=intervals, unidentifiable=(),
    )  # fmt: skip
    for name, row in zip(names, identified_table(IdentifiedRobot(robot, found, cast(Any, None), None)).rows):
        ends = [float(end) for end in str(row[3]).removesuffix(robot[name].unit).split(" to ")]
        assert ends == pytest.approx(intervals[name], abs=0.1 * share * robot[name].value)


def test_the_table_of_two_joints_is_read_at_80_columns() -> None:
    """Numbers of any size and names of two words beside each other: no name is cut."""
    names = ("stiffness_shoulder", "friction_elbow", "rotor_inertia_shoulder")
    robot = fh.load_robot("planar-two-link")
    found: Any = SimpleNamespace(
        names=names, hidden=(), consistent=False, values={name: robot[name].value for name in names},
        standard_errors={name: 0.0123456 * robot[name].value for name in names},
        intervals={name: (0.987654 * robot[name].value, 1.0123456 * robot[name].value) for name in names},
        unidentifiable=(), alternative=None, absorbing=True, consistency=correlated(), disturbance=0.01,
        plant=robot.plant(),
        disturbances={"motor_torque_shoulder": (0.5, 0.01)},
    )  # fmt: skip
    result = IdentifiedRobot(robot, found, FILTERED, None, ())
    console = Console(width=80, file=io.StringIO(), record=True)
    console.print(identified_table(result).terminal())
    text = console.export_text()
    words = {word for name in names for word in name.split("_")}
    assert unnamed(text, *words, "not") == []
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= 80
    verdict = " ".join(identified_verdict(result))
    assert unnamed(verdict, "joint_damping", "coulomb_friction") == []
    assert unnamed(verdict, "shoulder", 50, "NIS", 1.5, 0.9, 1.1, "motor position", 0.1) == []


def test_without_parameters_a_robot_without_tolerances_is_refused(
    logged: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (logged / "wrong.toml").read_text(encoding="utf-8")
    (logged / "wrong.toml").write_text(re.sub(r", tolerance = [\d.]+", "", text), encoding="utf-8")
    assert main(WORDS) == 2
    assert unnamed(capsys.readouterr().err, "--parameters", "tolerances") == []


@pytest.mark.ci("identifies two numbers of a log twice")
def test_parameters_and_noises_as_they_are_stated(logged: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Numbers with a tolerance are sought; a noise that is stated is not, and is that of the page's filter."""
    text = (logged / "wrong.toml").read_text(encoding="utf-8")
    kept = [
        line if re.match(r"(stiffness|friction) ", line) else re.sub(r", tolerance = [\d.]+", "", line)
        for line in text.splitlines()
    ]
    (logged / "wrong.toml").write_text("\n".join(kept), encoding="utf-8")
    noises = ["--measurement-noise", "0.2mrad", "--torque-noise", "1e-10"]
    for words, level in (([], 1e-4), (noises, 2e-4)):
        main([*WORDS, *words])
        numbers = json.loads((logged / "flexhinf-identify" / "identify.json").read_text(encoding="utf-8"))
        assert set(numbers["numbers"]) == {"stiffness", "friction"}
        assert numbers["noise"]["motor_position"] == pytest.approx(level, rel=1e-9 if words else 0.1)
        assert numbers["outputs"]["motor_position"]["whiteness"]["correlations"]
    assert numbers["disturbances"] == {"process noise": {"found": 1.0, "assumed": 1.0}}


@pytest.mark.parametrize(
    ("words", "anchors"),
    [
        (
            ["--parameters", "stiffness", "--sensor-delay", "motor_position"],
            ("--sensor-delay", "motor_position"),
        ),
        (["--parameters", "stiffness", "--sensor-delay", "motr=1"], ("motr", "motor_position")),
        (["--parameters", "stiffness", "--measurement-noise", "1,2,3"], ("noise", 3)),
        (["--parameters", "stifness"], ("stifness", "stiffness")),
        (["--parameters", "stiffness", "--robot", ""], ("--robot",)),
        (["--parameters", "stiffness", "--column", "motor_position=angle"], ("angle", "motor_position")),
    ],
)
def test_a_mistake_is_refused_before_any_work(
    logged: Path, words: list[str], anchors: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*WORDS, *words]) == 2
    assert unnamed(capsys.readouterr().err, *anchors) == []
    assert not (logged / "flexhinf-identify").exists()
