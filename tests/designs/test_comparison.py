"""Laws compared: gains against other routes to them, the loop without integrals, rivals of a task, and the rows."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_lyapunov
from tests import workspaces
from tests.builders import driven_robot
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf.analysis import EquilibriumLoop
from flexhinf.baselines import LinearQuadratic
from flexhinf.baselines.placed_laws import bessel_coefficients
from flexhinf.designs.compare import (
    ComparedController,
    Comparison,
    read_gains,
    rival_specification,
    rivals,
)
from flexhinf.designs.fields import resolved
from flexhinf.designs.laws import MODAL, NL_HINF, law_kind
from flexhinf.designs.requirements import REQUIREMENTS
from flexhinf.designs.task import Task
from flexhinf.designs.workspace import gain_search
from flexhinf.designs.workspace.rivals import check_numbers, over_of, rival_law
from flexhinf.designs.workspace.search import known_setup, pair_weights
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.errors import InvalidInput
from flexhinf.pages import comparison, comparison_ending, comparison_verdict
from flexhinf.robot.workspace import workspace_of

Named = Callable[[str], Any]
POSE = np.array([0.4, -0.7])
BOTH = ("link_position", "motor_position")
NUMBERS = {"bandwidth": 20.0, "share": 1.0, "rotor_inertia": 0.5, "vibration_damping": 0.2}


@pytest.fixture(scope="module")
def own() -> WorkspaceSetup:
    """A design's setup of two joints, without a search."""
    robot = fh.load_robot("planar-two-link")
    s = fh.Specification(measured=BOTH, workspace="limits")
    return known_setup(robot, s, Task(workspace_of(robot)), pair_weights(robot, 28.0), (0.0025, 0.03))


def with_rival(own: WorkspaceSetup, name: str, **numbers: Any) -> WorkspaceSetup:
    """The setup with a law of this name."""
    known = {"share", "vibration", *over_of(name).names}
    return replace(
        own, law=rival_law(own, name, {k: v for k, v in (NUMBERS | numbers).items() if k in known})
    )


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("name", ["pd-gravity", "torque-i", "lqg"])
def test_the_loop_of_a_rival_is_that_of_the_running_controller(own: WorkspaceSetup, name: str) -> None:
    """By derivatives of the traced step, of a PD without the integrals that it does not feed back."""
    made, s = with_rival(own, name), own.specification
    point = made.robot.operating_point(POSE)
    law: Any = replace(made.law, equilibrium=point)
    if name == "pd-gravity":
        law = LinearQuadratic(plant=law.plant, equilibrium=point, gain=law.slope_at(POSE)[:, :8])
    traced = EquilibriumLoop(
        law, made.filter, made.smooth_plant, s.period, equilibrium=point, moving=True, delay=s.unknown_samples,
        latency=s.known_latency, positions=made.model.states[:2],
    ).linear()  # fmt: skip
    found, expected = (
        np.sort(np.abs(loop.closed_loop.multipliers))[::-1][:10] for loop in (made.linear(POSE), traced)
    )
    np.testing.assert_allclose(found, expected, atol=2e-6)


def regulated(own: WorkspaceSetup, gain: np.ndarray) -> float:
    """How steeply the cost of a gain of LQG changes with it, relative to the cost: by SciPy, in torques at the joints
    of (M + J) ω² e, three times as much of (M + J) ω ė, half of (M + J) ω³ ∫e, and of u, each over its limit."""
    robot, period, n, w = own.robot, own.specification.period, 2, 20.0
    point = robot.operating_point(POSE)
    a, b, _, _ = own.law.plant.linearise(*point)
    whole = expm(period * np.block([[a, b], [np.zeros((n, 5 * n))]]))[: 4 * n]
    f = np.block(
        [[whole[:, : 4 * n], np.zeros((4 * n, n))], [period * np.eye(n), np.zeros((n, 3 * n)), np.eye(n)]]
    )
    g = np.vstack([whole[:, 4 * n :], np.zeros((n, n))])
    joints, zero = replace(own.law, equilibrium=point).joints, np.zeros((n, n))
    inertia = np.diag(1.0 / (own.authority * joints.torque_per_input)) @ (
        joints.link_inertia + np.diag(joints.motor_inertia)
    )
    errors = np.vstack([
        np.hstack([w**2 * inertia, *[zero] * 4]), np.hstack([zero, 3.0 * w * inertia, *[zero] * 3]),
        np.hstack([*[zero] * 4, 0.5 * w**3 * inertia]),
    ])  # fmt: skip

    def cost(k: np.ndarray) -> float:
        used = k / own.authority[:, None]
        return float(np.trace(solve_discrete_lyapunov((f + g @ k).T, errors.T @ errors + used.T @ used)))

    rng, slopes = np.random.default_rng(3), []
    for _ in range(4):
        way = 1e-4 * gain * rng.standard_normal(gain.shape)
        slopes.append(abs(cost(gain + way) - cost(gain - way)) / cost(gain))
    return max(slopes)


def test_the_estimator_expects_torques_in_parts_of_the_limits(own: WorkspaceSetup) -> None:
    """A quarter of a per cent of the motor's limit on a link, 3 % on the motor, held for a sample: velocities."""
    joints, limit = own.law.joints, own.authority * own.law.joints.torque_per_input
    jumps = np.array([0.0025 * limit / np.diag(joints.link_inertia), 0.03 * limit / joints.motor_inertia])
    found = [own.noise_levels.link_velocities, own.noise_levels.motor_velocities]
    np.testing.assert_allclose(np.sqrt(found), own.specification.period * jumps, rtol=1e-12)


@pytest.mark.oracle
def test_gains_are_those_of_textbooks(own: WorkspaceSetup) -> None:
    """PD by hand, the weight by differences of what a motor carries, and poles of flatness by a Bessel filter."""
    robot, n = own.robot, 2
    joints, home = (
        replace(own.law, equilibrium=robot.operating_point(q)).joints for q in (POSE, np.array(robot.home))
    )
    unit, inertia = joints.torque_per_input, np.diag(home.link_inertia) + home.motor_inertia
    slope = with_rival(own, "pd", share=1e6).law.slope_at(POSE)
    np.testing.assert_allclose(np.diag(slope[:, 2 * n : 3 * n]), -inertia * 20.0**2 / unit, rtol=1e-9)
    np.testing.assert_allclose(
        np.diag(slope[:, 3 * n : 4 * n]),
        -np.maximum(32.0 * inertia - home.motor_damping, 0.0) / unit,
        rtol=1e-9,
    )
    more = with_rival(own, "pd-gravity", share=1e6).law.slope_at(POSE) - slope
    (x, u), moved = (
        robot.operating_point(POSE),
        [robot.operating_point(POSE + 1e-6 * row) for row in np.eye(n)],
    )
    by_motor = np.column_stack([b - u for _, b in moved]) @ np.linalg.inv(
        np.column_stack([(a - x)[2 * n : 3 * n] for a, _ in moved])
    )
    np.testing.assert_allclose(more[:, 2 * n : 3 * n], by_motor, rtol=1e-4, atol=1e-6)
    assert regulated(own, with_rival(own, "lqg").law.slope_at(POSE)) < 1e-6
    flat = with_rival(own, "flatness-i", share=1e6).law
    law = replace(flat, equilibrium=robot.operating_point(POSE))
    chain = np.array([1.0, *bessel_coefficients(5, 20.0)[::-1]])
    np.testing.assert_allclose(np.poly(law.closed_loop()), np.polymul(chain, chain), rtol=1e-6)


def names(laws: list[str] | None, stated: tuple[str, ...] = (), drive: str = "", **fields: Any) -> list[str]:
    """Of the rivals of a design."""
    return [kind.name for kind in rivals(fh.Specification(**fields), laws, stated, drive)]


@pytest.mark.oracle
@pytest.mark.ci("setups of three robots")
def test_a_drive_of_its_own_has_the_loops_of_a_motor_of_torques() -> None:
    """Of a rival that gives torques: the inner loop counts as a part of its gains."""
    s = fh.Specification(measured=BOTH, workspace="limits")

    def slopes(robot: fh.Robot) -> list[np.ndarray]:
        a, b, _, _ = robot.plant().linearise(*robot.operating_point(POSE))
        made = known_setup(robot, s, Task(workspace_of(robot)), pair_weights(robot, 28.0), (0.0025, 0.03))
        laws = [with_rival(made, name).law.slope_at(POSE) for name in ("pid", "torque-i", "flatness-i")]
        return [a + b @ law[:, :8] for law in laws] + [b @ law[:, 8:] for law in laws]

    for drive, share in (("position", 0.4), ("velocity", 0.0)):
        robot = driven_robot("planar-two-link", drive, (8.0, 15.0), share)
        p = robot.plant_parameters()
        friction = dict(zip(robot.joint_names, p["drive_damping"] + share * p["friction"], strict=True))
        torque = driven_robot("planar-two-link", "torque")
        torque = torque.with_values({f"friction_{joint}": value for joint, value in friction.items()})
        for found, wanted in zip(slopes(robot), slopes(torque), strict=True):
            np.testing.assert_allclose(found, wanted, rtol=1e-8, atol=1e-7)


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.costs("setups of two robots")
@pytest.mark.parametrize(("drive", "share"), [("position", 1.0), ("velocity", 0.0)])
def test_the_drive_alone_has_its_own_modes(drive: str, share: float) -> None:
    """The filter is beside a loop that feeds back no estimate: its modes are those of the plant."""
    robot = driven_robot("planar-two-link", drive, (8.0, 15.0), share)
    s = fh.Specification(measured=BOTH, workspace="limits")
    made = known_setup(robot, s, Task(workspace_of(robot)), pair_weights(robot, 28.0), (0.0025, 0.03))
    alone = replace(made, law=rival_law(made, f"{drive}-drive", {"bandwidth": 10.0}))
    gain = np.zeros((2, 8))
    gain[:, 4:6] = -10.0 * (drive == "velocity") * np.eye(2)
    np.testing.assert_array_equal(alone.law.slope_at(POSE)[:, :8], gain)
    if drive == "position":
        a = alone.smooth_plant.linearise(*robot.operating_point(POSE))[0]
        found = alone.linear(POSE).closed_loop.multipliers
        for mode in np.exp(s.period * np.linalg.eigvals(a)):
            assert np.abs(found - mode).min() < 1e-9


def test_a_comparison_has_the_drive_alone_where_drives_have_a_loop() -> None:
    assert names(None, drive="position")[:1] == ["position-drive"]
    assert names(None, drive="velocity")[:1] == ["velocity-drive"]
    assert not [name for name in names(None, drive="current") if name.endswith("-drive")]
    with refused_with(InvalidInput, "'position'", "'torque'", "--laws") as told:
        names(["position-drive"], drive="torque")
    advised = re.findall("--laws ([a-z,-]+)", str(told.value))
    assert names(advised[0].split(","), drive="torque")
    with refused_with(InvalidInput, "[position-drive]"):
        check_numbers("position-drive", {}, 2)


def test_gains_of_a_move_are_those_of_its_poses(own: WorkspaceSetup) -> None:
    law = with_rival(own, "torque-i").law
    start, goal, x = np.array([-0.8, 1.0]), np.array([0.9, -1.1]), np.linspace(-1.0, 1.0, 10)
    there = law.along(start, goal)
    for share, exact in ((0.0, 1e-12), (0.25, 1e-12), (1.0, 1e-12), (0.3, 2e-2)):
        pose = start + share * (goal - start)
        state, held = own.robot.operating_point(pose)
        found = there.evaluate_about(x, state, held, there.law_data)
        np.testing.assert_allclose(found, law.slope_at(pose) @ x, rtol=exact, atol=exact)


@pytest.mark.ci("compiles a run of a rival")
@pytest.mark.parametrize("name", ["pd", "pid"])
def test_a_robot_that_is_heavier_than_the_model_begins_at_rest(own: WorkspaceSetup, name: str) -> None:
    """Without integrals it rests beside the command, where the feedback holds it; with them at the command."""
    quiet = replace(with_rival(own, name), specification=replace(own.specification, measurement_noise=1e-18))
    values = own.true.robot.random_corners(3, 5)[0]
    ends = np.array([POSE, POSE])
    _, options = quiet.move_arguments(ends, values)
    before = options["initial_state"][:2]
    after = quiet.move(ends, values, dwell=0.3).response.positions[-1]
    np.testing.assert_allclose(after, before, atol=2e-5)
    assert (np.abs(before - POSE).max() > 1e-4) == (name == "pd")


# What is stated -----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("numbers", "what"),
    [
        ({"bandwith": 3.0}, "bandwith"),
        ({"bandwidth": [1.0, 2.0, 3.0]}, "list of 2"),
        ({"bandwidth": float("nan")}, "finite"),
        ({"bandwidth": "fast"}, "finite"),
        ({"bandwidth": 0.0}, "positive"),
        ({"kp": 1.0, "kd": -1.0}, ">= 0"),
        ({"kp": 100.0, "kd": 1.0}, "ki"),
        ({}, "bandwidth"),
    ],
)
def test_gains_that_do_not_fit_are_refused(numbers: dict[str, Any], what: str) -> None:
    with refused_with(fh.InvalidInput, what):
        check_numbers("pid", numbers, 2)


def test_gains_per_joint_are_taken_as_they_are(own: WorkspaceSetup) -> None:
    stated = check_numbers("pid", {"kp": [400.0, 90], "kd": 5.0, "ki": [100.0, 30.0]}, 2)
    slope, unit = rival_law(own, "pid", stated).slope_at(POSE), own.law.joints.torque_per_input
    np.testing.assert_allclose(np.diag(slope[:, 4:6]), -np.array([400.0, 90.0]) / unit)
    np.testing.assert_allclose(np.diag(slope[:, 6:8]), -5.0 / unit)
    np.testing.assert_allclose(np.diag(slope[:, 8:]), -np.array([100.0, 30.0]) / unit)


@pytest.mark.parametrize(
    ("text", "what"), [("", "empty"), ("bandwidth = 2.0", "[pid]"), ("[pid", "TOML"), (None, "no file")]
)
def test_a_file_of_gains_is_read_or_refused(text: str | None, what: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    if text is not None:
        file.write_text(text)
    with refused_with(fh.InvalidInput, what):
        read_gains(file)


def test_the_usual_rivals_serve_the_task_and_the_design_s_own_law_is_none() -> None:
    usual = ["pd-gravity", "pid", "torque-i", "flatness-i", "lqg"]
    assert names(None, drive="current") == usual
    assert names(None, drive="current", law="pid") == [MODAL, *(name for name in usual if name != "pid")]
    assert names(None, drive="current", pose="10deg") == [MODAL, *usual]
    assert names(None, drive="current", pose="10deg", law=MODAL) == [NL_HINF, *usual]
    assert names(["pid", MODAL, "pid"]) == ["pid"]
    assert names(["pid"], ("pid",), law="pid") == ["pid"]  # with other gains


def test_laws_of_one_pose_and_gains_of_others_are_refused() -> None:
    for laws, stated, what in (
        (["nl-hinf"], (), "--pose home"),
        (["pid"], ("lqg",), "pid,lqg"),
        (["pd-x"], (), "pd"),
        (["hinf"], (), "nl-hinf"),
    ):
        with refused_with(fh.InvalidInput, what):
            names(laws, stated)
    for law in (MODAL, NL_HINF):
        with refused_with(fh.InvalidInput, f"[{law}]"):
            check_numbers(law, {"bandwidth": 2.0}, 1)


def test_a_rival_has_the_task_of_the_design_and_its_own_sensors(robot_of: Named) -> None:
    """Requirements stay; what only the design's law reads is not asked of others, nor an estimator by its sensors."""
    robot = robot_of("paper")
    s = resolved(robot, fh.Specification(pose="10deg", bandwidth=3.0, preset="damped", ripple=4.0, draws=7))
    assert s.estimator == "ukf"
    pid = rival_specification(robot, s, law_kind("pid"), same_sensors=False)
    assert (pid.law, pid.pose, pid.ripple, pid.draws, pid.bandwidth, pid.preset) == (
        "pid", s.pose, s.ripple, 7, None, None,
    )  # fmt: skip
    assert (pid.measured, pid.estimator) == (BOTH, "modal")
    assert rival_specification(robot, s, law_kind("pid"), same_sensors=True).measured == s.measured
    ekf = resolved(robot, fh.Specification(pose="10deg", estimator="ekf"))
    assert rival_specification(robot, ekf, law_kind("lqg"), same_sensors=False).estimator == "ekf"
    true = resolved(robot, fh.Specification(pose="10deg", estimator="none", law=MODAL))
    assert rival_specification(robot, true, law_kind(NL_HINF), same_sensors=False).estimator == "none"


# Rows ---------------------------------------------------------------------------------------------------
@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few poses, moves and bandwidths."""
    workspaces.few(monkeypatch, POSES=3, GOALS=2, CHOSEN_POSES=2, MODAL_POSES=30, BANDWIDTHS=(28.0,))
    workspaces.few(monkeypatch, TUNING_POSES=(2, 1), TUNING_MOVES=1)
    monkeypatch.setattr(gain_search, "BANDWIDTHS", (320.0, 30.0))


@pytest.mark.costs("designs for a workspace of one joint, and runs two more laws")
def test_each_law_has_a_row_and_the_report_says_which_is_best(
    small: None, robot_of: Named, tmp_path: Path
) -> None:
    """A stated law that cannot hold the arm has its row too."""
    wanted, told = fh.Specification(workspace=((0.0, 0.5),), estimator="none"), list[str]()
    gains = {"pid": {"kp": 0.01, "kd": 0.01, "ki": 0.0}}
    found = fh.compare(robot_of("paper"), wanted, ["pid", "flatness-i"], progress=told.append, gains=gains)
    assert [row.name for row in found.rows] == ["design", "pid", "flatness-i"]
    pid, flat = found.row("pid"), found.row("flatness-i").judged
    assert pid.judged is not None
    assert flat is not None
    assert (pid.stated, pid.met, pid.judged.bandwidth) == (True, False, None)
    assert {*flat.numbers} == {"bandwidth", "vibration"}
    assert {name.split(":")[0] for name in told if ":" in name} >= {"pid", "flatness-i"}
    folder = found.save(tmp_path / "report")
    numbers = json.loads((folder / "comparison.json").read_text(encoding="utf-8"))
    assert [(law["name"], law["law"]) for law in numbers["laws"]] == [
        ("design", MODAL), ("pid", "pid"), ("flatness-i", "flatness-i"),
    ]  # fmt: skip
    assert all(law["requirements"] for law in numbers["laws"])
    page, end = (folder / "index.html").read_text(encoding="utf-8"), comparison_ending(found).text
    assert unnamed(page, "Criterion", "flatness-i", "kp") == []
    assert unnamed(" ".join(end.split()), "Criterion:", "best rival") == []


@pytest.mark.ci("designs of three laws about one pose")
def test_laws_at_a_pose_are_designs_of_the_same_motion(
    robot_of: Named, only_uncertain: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Each row is what `design` makes of that law; one that could not be made says why."""
    monkeypatch.setattr(gain_search, "BANDWIDTHS", (320.0, 30.0))
    workspaces.few(monkeypatch, TUNING_MOVES=1)
    robot = only_uncertain(robot_of("paper"), "stiffness", "friction")
    s = fh.Specification(pose="10deg", start="0", degrees=(2,), rays=0, draws=2, torque_noise=1e-5)
    found = fh.compare(robot, s, ["pid", MODAL], gains={"pid": {"kp": 0.01, "kd": 0.01, "ki": 0.0}})
    assert [row.name for row in found.rows] == ["design", "pid", MODAL]
    for row, law in zip(found.rows, (NL_HINF, "pid", MODAL), strict=True):
        assert row.judged is not None, row.failure
        assert (row.judged.specification.law, row.judged.specification.pose) == (
            law,
            found.specification.pose,
        )
        (move,) = row.judged.moves
        np.testing.assert_allclose([move.response.start, move.response.goal], [[0.0], [np.radians(10.0)]])
    alone = fh.design(robot, s)
    assert alone.requirements == found.own.requirements
    modal = fh.design(robot, replace(s, law=MODAL, degrees=None, rays=None))
    assert modal.requirements == found.row(MODAL).requirements
    shared = {line.what for line in found.own.requirements} & {line.what for line in modal.requirements}
    assert {"overshoot", "remaining error", "unstable corners"} <= shared
    page = (found.save(tmp_path / "report") / "index.html").read_text(encoding="utf-8")
    assert unnamed(page, "Criterion", "smallest overshoot", "pid", "figure-laws") == []
    nothing = {"draws": 0, "rays": 0, "degrees": (2,), "estimator": "ekf"}
    lost = fh.compare(robot, fh.Specification(pose="10deg", start="0", **nothing), [MODAL], same_sensors=True)
    assert [row.name for row in lost.rows] == ["design", MODAL]


@pytest.mark.ci("tries ten estimators at two poses")
def test_stated_numbers_get_the_estimator_that_lacks_least(
    own: WorkspaceSetup, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of all that are tried, each looked at whole."""
    workspaces.few(monkeypatch, TUNING_POSES=(2, 1))
    search = gain_search.GainSearch(own, law_kind("pid"))
    numbers = {"bandwidth": (12.0,)}
    lacking = {each.random: search.poses.excess(each).tolist() for each in search._at(numbers)}
    found = search.stated(numbers)
    assert found.numbers == numbers
    assert lacking[found.random] == min(lacking.values()) < max(lacking.values())


@pytest.mark.parametrize(
    ("own", "rival", "parts"),
    [
        (1e-3, 5e-4, ("pid", "too", "beats", "0.5 mrad", "1 mrad")),
        (1e-3, 4e-3, ("pid", "loses")),
        (1e-3, 6e-3, ("design alone", "pid", "misses", "tracking error")),
        (6e-3, 1e-3, ("pid, meets", "does not")),
        (6e-3, 7e-3, ("No law", "by design")),
    ],
)  # fmt: skip
def test_the_verdict_says_the_criterion_and_who_is_better(
    own: float, rival: float, parts: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(comparison, "_degrees", lambda comparison: False)

    def row(name: str, found: float) -> ComparedController:
        line = REQUIREMENTS["tracking"].judge(None, 5e-3, found, "moves", unit="rad")
        judged: Any = SimpleNamespace(requirements=(line,), missed=(line,) * line.missed, met=line.met)
        return ComparedController(name, law_kind("pid"), judged)

    robot: Any = None
    rows = row("design", own), row("pid", rival)
    text = comparison_verdict(Comparison(robot, fh.Specification(), rows))
    assert text.startswith("Criterion: ")
    assert unnamed(text, *parts) == []
