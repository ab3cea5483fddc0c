"""``flexhinf export``: from a report, from a controller's file, from a design file alone."""

from __future__ import annotations

import hashlib
import math
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.builders import arm_controller, joint_text
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf import report
from flexhinf.cli import main
from flexhinf.cli.designs import DesignedController, refuse_unlimited
from flexhinf.designs.design_file import robot_digests
from flexhinf.designs.responses import joint_limits
from flexhinf.designs.verdict import DesignVerdict
from flexhinf.errors import InvalidInput
from flexhinf.export import check_limits, protected, unlimited_inputs

# Code is exported and not run; what it computes is tested in tests/export: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.fixture
def controller(tmp_path: Path) -> Path:
    arm_controller(kind=None).save(tmp_path / "controller")
    return tmp_path / "controller"


@pytest.fixture
def no_design(monkeypatch: pytest.MonkeyPatch) -> None:
    """A design that is begun is an error."""

    def stop(*given: object) -> None:
        raise fh.InvalidInput("A design begins.")

    monkeypatch.setattr(fh, "design", stop)


def test_the_file_of_a_controller(
    controller: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "c", str(controller), "--out", str(tmp_path / "c"), "--name", "arm"]) == 0
    assert {"arm.c", "arm.h", "arm_test.c", "README.md"} <= {path.name for path in (tmp_path / "c").iterdir()}
    assert "make -C" in capsys.readouterr().out


@pytest.mark.ci("starts flexhinf")
def test_a_controller_that_is_there_needs_neither_a_synthesis_nor_pages(controller: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from flexhinf.cli.designs import controller_of;"
        f"controller_of(Path({str(controller)!r}));"
        "print({'flexhinf.designs.pipeline', 'flexhinf.pages.page', 'scipy', 'matplotlib'} & set(sys.modules))"
    )
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert outcome.stdout.strip() == "set()"


@pytest.mark.ci("exports C twice")
def test_the_report_of_a_design(
    controller: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The controller of a report is taken while the design file beside it is the one that it was made of. What is
    written has the name of its folder; of another file that file's name."""
    said = "Specification met. " + 20 * "Words of the verdict. "
    design = f'[design]\nrobot = "paper"\n[result]\nverdict = "{said}"\n'
    folder = report.write(tmp_path / "arm", {"design.toml": design, "controller": controller.read_bytes()})
    assert report.unchanged(folder, ("design.toml", "controller"))
    for source in (folder, folder / "design.toml"):
        out = tmp_path / f"of-{source.name}"
        assert main(["export", "c", str(source), "--out", str(out)]) == 0
        assert (out / "paper.c").exists() or len(list(out.glob("*.c"))) == 3
        header = next(out.glob("*.h")).read_text()
        assert (
            hashlib.sha256(design.encode()).hexdigest() in header
        )  # which design it is, and what exports it again
        unfolded = re.sub(r"\n \* +", " ", header)  # no line has over 120 characters, and paths are long
        assert f" made by: flexhinf export c {source} --name " in unfolded
        assert said.strip() in " ".join(unfolded.split())
    (tmp_path / "own").mkdir()
    monkeypatch.chdir(tmp_path / "own")
    named = [folder, folder / "design.toml", folder / "controller"]
    named += [controller.rename(tmp_path / "wrist.v2.controller")]
    for source, name in zip(named, ("arm-c", "arm-c", "arm-c", "wrist.v2-c"), strict=True):
        assert main(["export", "c", str(source), "--force"]) == 0
        assert f"make -C {name} test" in capsys.readouterr().out
        assert (tmp_path / "own" / name / "README.md").is_file()
    (folder / "design.toml").write_text(design + "bandwidth = 2.0\n")
    assert not report.unchanged(folder, ("design.toml", "controller"))
    assert not report.unchanged(folder, ("design.toml", "missing"))
    assert not report.unchanged(tmp_path, ("controller",))


@pytest.mark.ci("exports C twice")
def test_the_header_says_when_and_of_which_robot_file_and_two_exports_are_the_same(
    controller: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    files = {
        "design.toml": '[design]\nrobot = "paper"\n',
        "design.json": "{}",
        "controller": controller.read_bytes(),
    }
    (digest,) = (digests := robot_digests("paper", None)).values()
    folder = report.write(tmp_path / "arm", files, digests)
    monkeypatch.delenv("SOURCE_DATE_EPOCH")
    written = []
    for out in (tmp_path / "one", tmp_path / "two"):
        assert main(["export", "c", str(folder), "--out", str(out), "--name", "arm"]) == 0
        written.append(
            {path.relative_to(out): path.read_bytes() for path in out.rglob("*") if path.is_file()}
        )
    assert written[0] == written[1]
    header = written[0][Path("arm.h")].decode()
    assert unnamed(header, "1970-01-02", digest) == []


def test_limits_are_looked_at_before_a_design(
    no_design: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    design = tmp_path / "design.toml"
    design.write_text('[design]\nrobot = "paper"\n')
    assert main(["export", "c", str(design), "--out", str(tmp_path / "c")]) == 2
    assert unnamed(capsys.readouterr().err, "motor_voltage", "--no-limits", "48.0") == []
    design.write_text('[design]\nrobot = "paper"\nsaturation = 48.0\n')
    assert main(["export", "c", str(design), "--out", str(tmp_path / "c")]) == 2
    assert unnamed(capsys.readouterr().err, "motor_voltage") == ["motor_voltage"]


def guessed_arm(path: Path) -> Path:
    """A robot file of a single link whose stiffness and friction are estimates."""
    guess = '{{ value = {}, source = "Estimate: of its size" }}'.format
    motor = f"motor_inertia = 0.1\nfriction = {guess(0.5)}"
    path.write_text(joint_text("shoulder", spring=f"stiffness = {guess(100.0)}", motor=motor))
    return path


@pytest.mark.costs("exports C, and asks five commands")
def test_a_robot_with_estimates_is_exported_on_purpose_only(
    controller: Path, no_design: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    guessed_arm(tmp_path / "arm.toml")
    design = tmp_path / "design.toml"
    design.write_text('[design]\nrobot = "arm.toml"\nsaturation = 48.0\n')
    for kind in ("c", "fmu"):
        arguments = ["export", kind, str(design), "--out", str(tmp_path / kind)]
        assert main(arguments) == 2
        words = ("estimated, not measured: stiffness, friction", "flexhinf identify", "--accept-estimates")
        assert unnamed(capsys.readouterr().err, *words) == []
        assert main([*arguments, "--accept-estimates"]) == 2
        assert "A design begins." in capsys.readouterr().err
    files = {"design.toml": design.read_bytes(), "controller": controller.read_bytes()}
    folder = report.write(tmp_path / "report", files)
    (folder / "arm.toml").write_text((tmp_path / "arm.toml").read_text())
    assert main(["compile", str(folder), "--out", str(tmp_path / "arm.so")]) == 2
    assert main(["export", "c", str(folder), "--out", str(tmp_path / "c"), "--accept-estimates"]) == 0
    assert unnamed(capsys.readouterr().err, "stiffness", "friction") == []
    header = next((tmp_path / "c").glob("*.h")).read_text()
    assert unnamed(header, "stiffness", "friction", "--accept-estimates") == []


@pytest.mark.parametrize("changed", ["design.toml", "controller"])
def test_what_was_changed_since_the_report_is_named(
    changed: str, controller: Path, tmp_path: Path, no_design: None, capsys: pytest.CaptureFixture[str]
) -> None:
    """A damaged controller is not told as a design file that was changed."""
    files = {
        "design.toml": b'[design]\nrobot = "paper"\nsaturation = 48.0\n',
        "controller": controller.read_bytes(),
    }
    folder = report.write(tmp_path / "arm", files)
    (folder / changed).write_bytes(files[changed] + b"\n")
    assert main(["export", "c", str(folder), "--out", str(tmp_path / "c")]) == 2
    told = capsys.readouterr().err
    assert "A design begins." in told
    assert [name for name in files if f"{name} was changed" in told] == [changed]


@pytest.mark.parametrize("changed", ["arm.toml", "controller", ""])
def test_a_robot_that_was_changed_since_the_report_is_designed_anew(
    changed: str,
    controller: Path,
    folder: Path,
    arm: str,
    no_design: None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A comment counts as a change. `controller`: the file was deleted. "": the controller of another robot."""
    (folder / "arm.toml").write_text(arm := f"gravity = 0.0\n{arm}")
    arms = report.write(
        folder / "arm",
        {
            "design.toml": '[design]\nrobot = "../arm.toml"\nsaturation = 48.0\n',
            "controller": controller.read_bytes(),
        },
        robot_digests("arm.toml", None, folder / "arm"),
    )
    assert report.sources(arms) == {
        "../arm.toml": hashlib.sha256((folder / "arm.toml").read_bytes()).hexdigest()
    }
    assert main(["export", "c", "arm", "--out", "before"]) == 0
    assert "anew" not in capsys.readouterr().err
    if changed == "arm.toml":
        (folder / "arm.toml").write_text(arm.replace("100.0", "130.0"))
    elif changed == "controller":
        (arms / "controller").unlink()
    else:
        arm_controller(kind=fh.ExtendedKalmanFilter, at=0.0).save(arms / "controller")
    assert main(["export", "c", "arm", "--out", "after"]) == 2
    told = capsys.readouterr().err
    assert unnamed(told, "A design begins.", "anew", changed or "belongs") == []
    assert not (folder / "after").exists()


@pytest.mark.parametrize("source", ["paper", "arm.toml"])
def test_a_robot_is_told_from_a_controller(
    source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before a folder that is there."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.c").write_text("mine")
    assert main(["export", "c", source if "." in source else "paper", "--out", "full"]) == 2
    assert "--force" not in capsys.readouterr().err
    (tmp_path / "arm.toml").write_text('[[joint]]\nname = "shoulder"\n')
    for words in (["export", "c"], ["export", "fmu"], ["compile"]):
        assert main([*words, source, "--out", "made"]) == 2
        told = capsys.readouterr().err
        assert "controller" in told
        assert f"flexhinf design {source}" in told
    assert not (tmp_path / "made").exists()


#: The result of a design that meets one of two requirements.
RESULT = """
[[result.requirements]]
what = "ripple"
limit = 5.0
at_most = true
found = 7.125
unit = "%"
met = false
[[result.requirements]]
what = "damping"
limit = 0.3
at_most = false
found = 0.4
unit = ""
met = true
"""


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("words", [["export", "c"], ["export", "fmu"], ["compile"]], ids=" ".join)
@pytest.mark.parametrize("met", [False, True])
def test_a_design_that_is_not_met_is_exported_on_purpose_with_a_note(
    met: bool, words: list[str], controller: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """On the terminal, and for code in README.md and in the header. Without --accept-unmet it is refused."""
    text = '[design]\nrobot = "paper"\n' + (RESULT.replace("false", "true") if met else RESULT)
    report.write(folder / "arm", {"design.toml": text, "controller": controller.read_bytes()})
    missed = "ripple: 7.12 % (at most 5 %)"
    if not met:
        assert main([*words, "arm", "--out", "out"]) == 2
        assert unnamed(capsys.readouterr().err, "own requirements", missed, "--accept-unmet") == []
        assert not (folder / "out").exists()
    assert main([*words, "arm", "--out", "out", *(() if met else ("--accept-unmet",))]) == 0
    told = capsys.readouterr().err
    assert ("ripple" in told, missed in told) == (not met, not met)
    assert "damping" not in told
    for file in ("README.md", "paper.h") if words[-1] == "c" else ():
        assert (missed in (folder / "out" / file).read_text()) is not met


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("kind", ["c", "fmu"])
@pytest.mark.parametrize("limits", [None, (-48.0, math.inf), 48.0])
def test_an_input_without_limits_is_exported_on_purpose_only(
    kind: str, limits: Any, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    law = fh.linear_law(fh.paper_arm().problem(), gamma=math.inf)
    fh.Controller(law, None, 1e-3, limits).save(folder / "controller")
    code = 0 if limits == 48.0 else 2
    assert main(["export", kind, "controller", "--out", "made"]) == code
    told = capsys.readouterr().err
    words = ("motor_voltage", "effort_limit", "[[joint]]", "--saturation", "--no-limits")
    assert not told if code == 0 else unnamed(told, *words) == []
    assert (folder / "made").exists() is (code == 0)
    assert main(["export", kind, "controller", "--out", "other", "--no-limits"]) == 0
    assert ("motor_voltage" in capsys.readouterr().err) is (code != 0)
    if kind == "c":  # the command that is stated exports it again
        assert "--no-limits" in (folder / "other" / "README.md").read_text(encoding="utf-8")


def test_the_key_that_the_refusal_names_limits_the_controller() -> None:
    arm = fh.load_robot("scara")
    limits = joint_limits(arm, fh.Specification()).saturated
    assert limits is not None
    assert limits.tolist() == list(arm.effort_limits or ())


@pytest.mark.quick_cases(4)
@pytest.mark.parametrize("saturation", [None, 48.0])
@pytest.mark.parametrize("name", fh.catalogue())
def test_a_design_that_is_not_made_yet_is_judged_as_its_controller(
    name: str, saturation: float | None
) -> None:
    robot, s = fh.load_robot(name), fh.Specification(saturation=saturation)
    law = fh.linear_law(
        robot.problem(fh.Penalty({"link_position": 60.0, "link_position_integral": 300.0}, effort=1.0)),
        gamma=math.inf,
    )
    controller = fh.Controller(law, None, 1e-3, joint_limits(robot, s).saturated)
    free = unlimited_inputs(controller)
    assert bool(free) == (saturation is None and not np.isfinite(robot.effort_limits or np.inf).all())
    if not free:
        refuse_unlimited(robot, s)
        return
    refusals = []
    for refused in (lambda: refuse_unlimited(robot, s), lambda: check_limits(controller)):
        with pytest.raises(InvalidInput) as caught:
            refused()
        refusals.append(caught.value.what)
    assert refusals[0] == refusals[1]
    assert unnamed(refusals[0], *free) == []


def test_a_plant_has_no_inputs_to_limit(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "design.toml").write_text('[design]\nrobot = "paper"\n')
    assert main(["export", "fmu", "design.toml", "--plant", "--no-limits", "--out", "arm.fmu"]) == 2
    assert "--no-limits" in capsys.readouterr().err


def test_a_folder_with_files_needs_force(
    controller: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "c"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    words = ["export", "c", str(controller), "--out", str(out)]
    assert main(words) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*words, "--force"]) == 0
    assert (out / "mine.txt").read_text() == "mine"


def test_limits_are_narrowed_with_a_new_test_vector(
    controller: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A torque cap of first motions: the vector's own inputs keep it, and it is only taken where it is one."""
    words = ["export", "c", str(controller), "--name", "arm", "--out", str(tmp_path / "c")]
    for limit in ("1000", "0", "-2"):
        assert main([*words, "--narrower", limit]) == 2
        assert "--narrower" in capsys.readouterr().err
    assert main([*words, "--narrower", "20"]) == 0
    assert "narrower" in capsys.readouterr().err
    texts = [(tmp_path / "c" / name).read_text(encoding="utf-8") for name in ("README.md", "arm_test.c")]
    assert "| saturation | -20 to 20 |" in texts[0]
    assert "--narrower" in texts[0]
    inputs = re.findall(r"[-+\d.e]+", texts[1].partition("expected_u[RUNS]")[2].partition("size_of_u")[0])
    assert (
        max(abs(float(number)) for number in inputs if re.fullmatch(r"-?\d+\.\d+", number)) == 12.0
    )  # NARROWER


def test_a_stored_law_is_called_what_it_was(controller: Path, tmp_path: Path) -> None:
    assert main(["export", "c", str(controller), "--out", str(tmp_path / "c")]) == 0
    assert "| law | HJISolution |" in (tmp_path / "c" / "README.md").read_text()


@pytest.mark.ci("designs and exports")
def test_the_gear_ratios_of_the_robot_are_stated(
    controller: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot of a report's design file; the file of a controller has none."""
    robot, s = fh.load_robot("quanser-rotflex"), fh.Specification()
    found = DesignedController(fh.load_controller(controller), robot, s)
    for k, (one, text) in enumerate(
        [(found, "(motor angle / 70)"), (DesignedController(found.controller), "after the gear")]
    ):
        monkeypatch.setattr("flexhinf.cli.exports.controller_of", lambda path, one=one, **options: one)
        assert main(["export", "c", str(controller), "--out", str(tmp_path / str(k))]) == 0
        assert text in (tmp_path / str(k) / "README.md").read_text()


@pytest.mark.ci("exports once more")
def test_it_says_that_only_constants_were_counted(
    controller: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["export", "c", str(controller), "--out"]
    monkeypatch.setattr("flexhinf.export.refusals.cortex_m4_bytes", lambda code: None)
    assert main([*words, str(tmp_path / "a"), "--flash", "64kB"]) == 0
    assert unnamed(capsys.readouterr().err, "note", "--flash", "constants", "arm-none-eabi-gcc") == []
    monkeypatch.setattr("flexhinf.export.refusals.cortex_m4_bytes", lambda code: 1)
    assert main([*words, str(tmp_path / "b"), "--flash", "64kB"]) == 0
    assert "--flash" not in capsys.readouterr().err


@pytest.mark.ci("a design")
def test_a_design_file_alone_is_designed_first(arm: str, tmp_path: Path) -> None:
    """Of a robot without tolerances, and with what a design of one pose would search."""
    (tmp_path / "arm.toml").write_text(f"gravity = 0.0\n{arm}")
    (tmp_path / "design.toml").write_text(
        '[design]\nrobot = "arm.toml"\npose = "home"\ndegrees = [2]\nrays = 0\ndraws = 0\nsaturation = 48\n'
        "torque_noise = 1e-5\n"
    )
    out = tmp_path / "c"
    words = [
        "export",
        "c",
        str(tmp_path / "design.toml"),
        "--out",
        str(out),
        "--name",
        "arm",
        "--accept-unmet",
    ]
    assert main(words) == 0
    assert (out / "arm.c").exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["nothing-here"], "'nothing-here'"),
        ([], "DESIGN"),
        (["CONTROLLER", "--name", "while"], "arm_while"),
        (["CONTROLLER", "--real", "half"], "'half'"),
        (["CONTROLLER", "--period", "1 s"], "0.001 s"),
        (["CONTROLLER", "--flash", "10B"], "'10B' (--flash)"),
    ],
)
def test_a_mistake_writes_nothing(
    words: list[str], text: str, controller: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(controller) if word == "CONTROLLER" else word for word in words]
    assert main(["export", "c", *words, "--out", str(tmp_path / "c")]) == 2
    assert text in capsys.readouterr().err
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize("kind", ["c", "web"])
def test_a_wrong_name_is_told_before_the_output_and_nothing_is_replaced_in_silence(
    kind: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = folder / ("c" if kind == "c" else "arm.html")
    held = out / "mine.c" if kind == "c" else out
    held.parent.mkdir(exist_ok=True)
    held.write_text("mine")
    assert main(["export", kind, "nothere", "--out", out.name]) == 2
    told = capsys.readouterr().err
    assert ("'nothere'" in told, "--force" in told) == (True, False)
    (folder / "design.toml").write_text('[design]\nrobot = "paper"\n')
    assert main(["export", kind, "design.toml", "--out", out.name]) == 2
    assert "--force" in capsys.readouterr().err
    assert held.read_text() == "mine"


def test_what_a_robot_file_may_not_mean_is_a_note(
    controller: Path, folder: Path, arm: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not Python's own warning with a path of the package; for the arm in a horizontal plane."""
    (folder / "arm.toml").write_text(f"gravity = 981.0\n{arm}")
    made = report.write(
        folder / "arm",
        {
            "design.toml": '[design]\nrobot = "../arm.toml"\nsaturation = 48.0\n',
            "controller": controller.read_bytes(),
        },
        robot_digests("arm.toml", None, folder / "arm"),
    )
    assert main(["export", "c", made.name, "--out", "c"]) == 0
    told = capsys.readouterr().err
    assert unnamed(told, "note", "gravity") == []
    assert "RobotFileWarning" not in told


def test_a_requirement_that_is_missed_twice_says_where() -> None:
    row = {
        "what": "remaining error",
        "limit": 1e-3,
        "at_most": True,
        "found": 2e-3,
        "unit": "rad",
        "met": False,
    }
    corner = row | {"found": 3e-3, "where": "20 moves, robots at corners of their tolerances"}
    text = DesignVerdict.of([row, corner]).unmet
    assert unnamed(text, "nominal", "2 mrad", "corners", "3 mrad") == []
    assert "nominal" not in DesignVerdict.of([row]).unmet


def test_the_version_of_fmi_is_chosen(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    law = fh.linear_law(fh.paper_arm().problem(), gamma=math.inf)
    fh.Controller(law, None, 1e-3, 48.0).save(folder / "controller")
    assert main(["export", "fmu", "controller", "--fmi", "3.0", "--out", "arm.fmu"]) == 0
    with zipfile.ZipFile(folder / "arm.fmu") as archive:
        assert b'fmiVersion="3.0"' in archive.read("modelDescription.xml")
    assert main(["export", "fmu", "controller", "--fmi", "1.0", "--out", "other.fmu"]) == 2
    assert not (folder / "other.fmu").exists()


@pytest.mark.ci("exports two links twice")
def test_a_stored_protection_is_exported_unless_measurements_are_not_checked(folder: Path) -> None:
    arm = fh.load_robot("planar-two-link")
    plain = arm_controller(
        arm, fh.ExtendedKalmanFilter, pose=arm.home, measured=("link_position", "motor_position"), q=1e-6, r=1e-8,
        limit=100.0, supervision=fh.Supervision(following=0.2),
    )  # fmt: skip
    stored = protected(plain, arm)[0]
    stored.save(folder / "one")
    text = '[design]\nrobot = "planar-two-link"\n'
    report.write(folder / "arm", {"design.toml": text, "controller": (folder / "one").read_bytes()})
    for words, watched in (([], True), (["--no-check-measurements"], False)):
        out = f"c{len(words)}"
        assert main(["export", "c", "arm", "--out", out, "--name", "arm", *words]) == 0
        header = (folder / out / "arm.h").read_text()
        for name in ("ARM_P_LONGEST_UNSEEN", "int rejected[", "ARM_P_MEASUREMENT_RATE"):
            assert (name in header) is watched, (name, words)


@pytest.mark.ci("exports two links twice")
def test_measurements_are_checked_by_default(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With the robot's limits; where nothing states any, a note says so."""
    arm = fh.load_robot("planar-two-link")
    one = arm_controller(arm, fh.ExtendedKalmanFilter, pose=arm.home, q=1e-6, r=1e-8, limit=100.0)
    one.save(folder / "one")
    text = '[design]\nrobot = "planar-two-link"\n'
    report.write(folder / "arm", {"design.toml": text, "controller": (folder / "one").read_bytes()})
    for words in ([], ["--no-check-measurements"]):
        out = f"c{len(words)}"
        assert main(["export", "c", "arm", "--out", out, "--name", "arm", *words]) == 0
        header = (folder / out / "arm.h").read_text()
        assert ("ARM_P_MEASUREMENT_RATE" in header) is not bool(words)
        assert ("--no-check-measurements" in header) is bool(words)
        assert ("int rejected[" in header) is not bool(words)
    assert "speed_limit" not in capsys.readouterr().err
    assert main(["export", "c", "one", "--out", "other", "--name", "arm"]) == 0
    assert unnamed(capsys.readouterr().err, "robot", "speed_limit", "measurement_limits") == []
    assert "int rejected[" not in (folder / "other" / "arm.h").read_text()
