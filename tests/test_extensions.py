"""What other files add: a requirement, a law, an estimator and an export that no file of the package names.

The files are those that CONTRIBUTING.md prints. A package names them as its entry points, so each test runs a process
of its own, and nothing is added to the others.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from tests.refusals import refused_with, unnamed

from flexhinf.designs import judge
from flexhinf.designs.requirements import REQUIREMENTS, Motion, RequirementKind, register
from flexhinf.designs.specification import FIELDS, Specification
from flexhinf.errors import InvalidInput
from flexhinf.extensions import Registry

# Designs and exports in processes of their own, which make little with what they compile.
pytestmark = pytest.mark.usefixtures("unoptimised")

ADDED = ("requirement", "law", "estimator", "export", "sensor", "drive")

Run = Callable[..., subprocess.CompletedProcess[str]]


def package(folder: Path, name: str, points: dict[str, str]) -> None:
    """What an installed package leaves behind for `importlib.metadata`."""
    about = folder / f"{name}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = "".join(f"{point} = {module}\n" for point, module in points.items())
    (about / "entry_points.txt").write_text(f"[flexhinf.extensions]\n{lines}")


@pytest.fixture
def run(repository: Path, tmp_path: Path) -> Run:
    """Runs Python with arguments where a package adds the examples, in a folder of its own."""
    package(tmp_path, "my_package", {what: f"example_{what}" for what in ADDED})
    paths = [repository / "src", tmp_path, repository / "tests", *sys.path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths)), "COLUMNS": "200"}

    def runs(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, *words], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )  # fmt: skip

    return runs


def program(text: str) -> tuple[str, str]:
    return "-c", textwrap.dedent(text)


@pytest.mark.ci("the help of three commands in a process of its own")
def test_the_help_names_what_is_added(run: Run) -> None:
    done = run(*program("""
        from flexhinf.cli import main
        for words in ("design --help-all", "compare --help-all", "export --help", "export signals --help"):
            main(words.split())
    """))  # fmt: skip
    assert done.returncode == 0, done.stderr
    named = ("rise_time", "Longest rise time", "pd-critical", "fast-ekf", "a fast extended Kalman filter")
    assert unnamed(done.stdout, *named, "signals", "for a fieldbus") == []


@pytest.mark.costs("a process of its own")
def test_a_program_states_the_limit_as_any_field(run: Run) -> None:
    done = run(*program("""
        import pickle, tomllib
        from dataclasses import replace
        import flexhinf as fh
        from flexhinf.designs import design_schema, read_request
        from flexhinf.designs.design_file import request_document
        from flexhinf.designs.fields import resolved

        s = fh.Specification(rise_time="500ms", seed=3)
        assert s.rise_time == 0.5 and s == fh.Specification(rise_time=0.5, seed=3) != fh.Specification(seed=3)
        assert replace(s, seed=4).rise_time == 0.5 and replace(s, rise_time=None) == fh.Specification(seed=3)
        assert pickle.loads(pickle.dumps(s)) == s and s.pose is None
        text = request_document(s, "paper").as_string()
        assert tomllib.loads(text)["design"] == {"robot": "paper", "rise_time": 0.5, "seed": 3}
        open("design.toml", "w").write(text)
        asked = read_request("design.toml", is_file=True)
        assert asked.specification == resolved(asked.robot, s)
        assert design_schema()["properties"]["design"]["properties"]["rise_time"]["anyOf"][0]["exclusiveMinimum"] == 0
        for wrong in ({"rise_time": -1.0}, {"rise_tine": 1.0}, {"estimator": "fast-kf"}):
            try:
                fh.Specification(**wrong)
            except fh.InvalidInput as error:
                print(error.found, "|", error.advice)
    """))  # fmt: skip
    assert done.returncode == 0, done.stderr
    refusals = done.stdout.splitlines()
    assert len(refusals) == 3
    assert unnamed(refusals[0], "a time > 0, s", "rise_time=0.5") == []
    assert unnamed(refusals[1], "rise_time") == []
    assert unnamed(refusals[2], "fast-ekf", "estimator='fast-ekf'") == []


@pytest.mark.costs("copies the package, and runs a process of its own")
def test_a_file_among_those_of_the_package_is_found_by_itself(repository: Path, tmp_path: Path) -> None:
    """One file, and the limit has its option and its range, before anything computes; no other file changes."""
    shutil.copytree(
        repository / "src", tmp_path / "src", ignore=shutil.ignore_patterns("__pycache__", "*.egg-info")
    )
    folder = tmp_path / "src" / "flexhinf" / "designs" / "requirements"
    shutil.copy(repository / "tests" / "example_requirement.py", folder / "rise_time.py")
    code = "from flexhinf.cli import main; import sys; sys.exit(main(sys.argv[1:]))"
    for limit, words in (("-1s", ("rise time", "a time > 0", "--set rise_time")), ("no", ("rise_time",))):
        done = subprocess.run(
            [sys.executable, "-c", code, "design", "planar-two-link", "--set", f"rise_time={limit}"],
            cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(tmp_path / "src")},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 2
        assert unnamed(done.stderr, *words) == []
        assert "no setting" not in done.stderr


@pytest.mark.costs("a process of its own")
def test_a_robot_file_has_the_drive_and_the_sensor(run: Run, tmp_path: Path) -> None:
    """Inverse dynamics are the inverse of the plant, MuJoCo has the same loop, and refusals name both."""
    done = run("-m", "flexhinf", "init", "--joints", "2", "--drive", "damped-torque", "--out", "arm.toml")
    assert done.returncode == 0, done.stderr
    assert unnamed(done.stdout, "--period 4ms --latency 2") == []
    stated = (tmp_path / "arm.toml").read_text(encoding="utf-8")
    more = '[[joint.sensor]]\nkind = "twist_rate"\nstep = "0.01 rad/s"\nnoise = "1 mrad/s"\n'
    limit = stated.replace('name = "joint1"\n', 'name = "joint1"\neffort_limit = "12 N·m"\n')
    (tmp_path / "arm.toml").write_text(f"{limit}\n{more}", encoding="utf-8")
    done = run(*program("""
        import numpy as np, flexhinf as fh
        from flexhinf.robot import MuJoCoPlant
        arm = fh.load_robot("arm.toml")
        sensor = arm.sensors[0]
        assert (sensor.signal, sensor.step, sensor.noise) == ("twist_rate_joint2", 0.01, 1e-3)
        plant, motion = arm.plant(("link_position", "twist_rate")), np.array([0.3, -0.2]) * np.ones((5, 2))
        x, u = arm.inverse_dynamics(*motion)
        p = plant.parameters.named(plant.parameters.vector())
        rates = np.asarray(plant.flow(x, u, np.zeros(4), p), dtype=float)
        np.testing.assert_allclose(rates[2:4], motion[2], rtol=1e-9)  # accelerations of the links
        y = np.asarray(plant.output(x, u, p), dtype=float)
        np.testing.assert_allclose(y[2:], x[6:] - x[2:4], rtol=1e-12)
        damping = 2.0 * np.pi * 5.0 * arm["motor_inertia_joint1"].value  # J ω of 5 Hz
        np.testing.assert_allclose(arm.plant_parameters()["drive_damping"][0], damping, rtol=1e-3)
        other = MuJoCoPlant(arm)
        other.reset(x)
        other.step(u, np.zeros(4), 1e-4)
        now = np.asarray(other.state())
        np.testing.assert_allclose((now - x)[4:] / 1e-4, rates[4:], rtol=0.02, atol=0.05)
        assert plant.unit("torque_command_joint1") == "N·m"
        try:
            arm.plant("differential_meter")
        except fh.InvalidInput as error:
            print(error.found, error.advice)
    """))  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert unnamed(done.stdout, "twist_rate", "measured=('link_position', 'twist_rate')") == []
    wrong = (tmp_path / "arm.toml").read_text(encoding="utf-8").replace("12 N·m", "12 m/s^3")
    (tmp_path / "wrong.toml").write_text(wrong.replace("damped-torque", "dumped"), encoding="utf-8")
    done = run("-m", "flexhinf", "check", "wrong.toml")
    assert done.returncode == 2
    assert unnamed(done.stdout, "'damped-torque'", "effort_limit") == []


@pytest.mark.ci("designs and exports")
def test_a_design_has_the_requirement_and_the_estimator(run: Run, tmp_path: Path) -> None:
    options = "--pose 20deg --preset damped --degrees 2 --draws 0 --set rays=0 --set proof_seconds=0"
    own = "--set rise_time=0.1 --estimator fast-ekf --out arm"
    done = run("-m", "flexhinf", "design", "paper", *options.split(), *own.split())
    assert done.returncode == 1, done.stderr
    assert unnamed(done.stdout, "rise time", "≤ 0.1 s", "NOT MET") == []
    assert "rise time" in (tmp_path / "arm" / "index.html").read_text(encoding="utf-8")
    assert 'estimator = "fast-ekf"' in (tmp_path / "arm" / "design.toml").read_text(encoding="utf-8")
    numbers = json.loads((tmp_path / "arm" / "design.json").read_text(encoding="utf-8"))
    step, move = (line for line in numbers["requirements"] if line["what"] == "rise time")
    assert (step["limit"], step["unit"], step["stated_by"], step["met"]) == (
        0.1,
        "s",
        "--set rise_time",
        False,
    )
    other = numbers["runs"][0]["joints"][0]["rise_time_s"]  # interpolated between samples of 1 ms
    assert step["found"] == pytest.approx(other, abs=2e-3)
    assert move["found"] > step["found"]
    out = run("-m", "flexhinf", "export", "signals", "arm", "--out", "arm.json")
    assert out.returncode == 0, out.stderr
    signals = json.loads((tmp_path / "arm.json").read_text(encoding="utf-8"))
    assert signals == {"period_s": 1e-3, "measured": ["link_position"], "inputs": ["motor_voltage"]}
    again = run("-m", "flexhinf", "export", "signals", "arm", "--out", "arm.json")
    assert again.returncode == 2
    assert "--force" in again.stderr


@pytest.mark.ci("a design for a workspace in a process of its own")
def test_the_estimator_runs_over_a_workspace(run: Run) -> None:
    """It is an extended Kalman filter with a hundred times the noise of the one that the product would take."""
    done = run(*program("""
        import pytest, workspaces
        import flexhinf as fh

        few = {"POSES": 2, "GOALS": 1, "CHOSEN_POSES": 2, "MODAL_POSES": 20, "BANDWIDTHS": (10.0,)}
        workspaces.few(pytest.MonkeyPatch(), **few)
        s = fh.Specification(estimator="fast-ekf", workspace=((0.0, 0.1),), draws=0)
        design = fh.design(fh.paper_arm(), s)
        filter, setup = design.controller().estimator, design.evidence.setup
        assert type(filter) is fh.ExtendedKalmanFilter and design.specification.law == "modal"
        ratio = filter.process_noise / setup.noise_levels.covariance(setup.model.states)
        assert set(ratio[ratio == ratio].round(6).tolist()) == {100.0}
        assert max(loop.growth for loop in design.evidence.loops) < 1.0
    """))  # fmt: skip
    assert done.returncode == 0, done.stderr


@pytest.mark.ci("compares laws at a pose and over a workspace, four designs")
def test_a_comparison_has_the_law_about_a_pose_and_over_a_workspace(run: Run, tmp_path: Path) -> None:
    """Over a workspace with the requirement too, which each law has in its list."""
    (tmp_path / "gains.toml").write_text("[pd-critical]\nbandwidth = 4.0\n")
    small = "--draws 0 --estimator none"
    at_pose = f"--pose 20deg --degrees 2 --set rays=0 {small} --out pose"
    over = f"--workspace 0:0.02 {small} --gains gains.toml --set rise_time=20 --out over"
    for words in (at_pose, over):
        done = run("-m", "flexhinf", "compare", "paper", "--laws", "pd-critical", *words.split())
        assert done.returncode in (0, 1), done.stderr
        assert "pd-critical" in done.stdout
    for name in ("pose", "over"):
        text = (tmp_path / name / "comparison.json").read_text(encoding="utf-8")
        assert "pd-critical" in text
        assert "pd-critical" in (tmp_path / name / "index.html").read_text(encoding="utf-8")
    assert "rise time" in (tmp_path / "over" / "index.html").read_text(encoding="utf-8")
    assert text.count("rise time") > 1


@pytest.mark.costs("a process of its own")
def test_a_package_that_cannot_be_imported_is_named(run: Run, tmp_path: Path) -> None:
    package(tmp_path, "broken", {"mine": "broken_law"})
    (tmp_path / "broken_law.py").write_text("import no_such_library\n")
    done = run("-m", "flexhinf", "compare", "--help")
    assert done.returncode == 2
    assert unnamed(done.stderr, "'mine'", "broken_law", "no_such_library") == []
    assert "Traceback" not in done.stderr


# One requirement --------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Thing:
    name: Any


@pytest.mark.parametrize("name", ["", "Two", "a b", "naïve", "3x", None, "x" * 41, "there"])
def test_names_that_cannot_be_typed_or_are_there_are_refused(name: Any) -> None:
    registry: Registry[Thing] = Registry("thing", "flexhinf.designs.exports")
    registry.register(Thing("there"))
    with pytest.raises(InvalidInput) as refusal:
        registry.register(Thing(name))
    registry.register(Thing(refusal.value.advice))
    assert list(registry) == ["there", refusal.value.advice]


def test_a_registry_is_in_the_order_of_its_places() -> None:
    registry: Registry[Thing] = Registry("thing", "flexhinf.designs.exports", lambda thing: -len(thing.name))
    for name in ("a", "ccc", "bb", "dd"):
        registry.register(Thing(name))
    assert (list(registry), len(registry), registry["bb"].name) == (["ccc", "bb", "dd", "a"], 4, "bb")


@pytest.mark.parametrize("name", ["damping", "damped_below_limit", "two words"])
def test_a_limit_takes_no_other_field_s_name(name: str) -> None:
    before = list(FIELDS)
    with pytest.raises(InvalidInput) as refusal:
        register(
            RequirementKind(
                "mine", "mine", "", field=name, help="Largest of mine.", of_loop=cast("Any", float)
            )
        )
    assert refusal.value.advice.isidentifier() or name == "two words"
    assert list(FIELDS) == before
    assert "mine" not in REQUIREMENTS


def motion(joints: int = 2) -> Motion:
    """A run without noise, from 0 to 1, with its joints alike."""
    time = np.linspace(0.0, 1.0, 101)
    way, one = np.tile(time[:, None], (1, joints)), np.ones(joints)
    return Motion(
        time=time, positions=way, velocities=np.ones_like(way), inputs=way, planned=way, path=way, duration=1.0,
        step=False, plans=True, rests=False, effort=one, span=one, slides=np.zeros(joints, dtype=bool),
        lower=-one, upper=one, kept=one, rate=one, period=0.01,
    )  # fmt: skip


def test_what_measures_no_number_for_each_joint_is_refused() -> None:
    kind = RequirementKind("mine", "mine", "", of_motion=lambda motion: 2.0)
    values = kind.measured(motion())
    assert values is not None
    assert values.tolist() == [2.0, 2.0]
    for wrong in (np.ones(3), "fast", [[1.0], [2.0]]):
        with pytest.raises(InvalidInput, match="mine"):
            replace(kind, of_motion=lambda motion, wrong=wrong: wrong).measured(motion())
    assert replace(kind, of_motion=lambda motion: None).measured(motion()) is None


def test_the_rise_of_a_ramp_is_four_fifths_of_it() -> None:
    """Without registration: the function alone, of the file as it stands."""
    text = (Path(__file__).parent / "example_requirement.py").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    exec(text.partition("\nregister(")[0], names)
    assert names["rise_times"](motion()) == pytest.approx([0.8, 0.8])


def test_a_lower_limit_on_loops_is_judged_at_the_worst(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = RequirementKind(
        "decay",
        "slowest decay",
        "",
        "1/s",
        at_most=False,
        default=2.0,
        of_loop=lambda loop: cast("Any", loop.linear),
    )
    monkeypatch.setattr(judge, "on_loops", lambda: (kind,))
    loops: Any = [3.0, 1.0, 2.0]
    (line,) = judge.loop_requirements(Specification(), lambda: loops, "three poses")
    assert (line.found, line.limit, line.missed, line.where) == (1.0, 2.0, True, "three poses")
    assert kind.judge(None, 2.0, -np.inf, "").achieved_text == "diverges"
    assert kind.judge(None, 2.0, np.inf, "").achieved_text == "unlimited"
    monkeypatch.setattr(judge, "on_loops", lambda: (replace(kind, default=None),))
    assert judge.loop_requirements(Specification(), lambda: pytest.fail("unneeded")) == []


def test_a_kind_that_nothing_measures_is_refused() -> None:
    with refused_with(InvalidInput, "of_motion"):
        register(RequirementKind("mine", "mine", "", help="Largest of mine."))
    assert "mine" not in FIELDS
