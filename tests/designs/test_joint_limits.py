"""Limits and sensor steps, one per joint or signal: what states them, what keeps them, what is refused."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.cli.arguments import _value
from flexhinf.cli.messages import error_text
from flexhinf.designs import Specification, design
from flexhinf.designs.fields import resolved
from flexhinf.designs.judge import measured
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.noise_levels import other_quantisation, sensor_steps
from flexhinf.designs.plans import plan_move
from flexhinf.designs.request import read_request
from flexhinf.designs.responses import ROBOT, joint_limits
from flexhinf.designs.specification import FIELDS, SpecificationError
from flexhinf.designs.stated_units import check_stated_units
from flexhinf.designs.synthesis.by_step import COARSE, MIN_FRACTION, WIDTH, _BandwidthSearch
from flexhinf.designs.synthesis.steps import _refuse_early
from flexhinf.errors import InvalidInput

Named = Callable[[str], Any]
GOAL, START = (0.4, 0.6), (0.1, 0.8)


def limited(robot: Any, **limits: Any) -> Any:
    return dataclasses.replace(robot, **limits)


@pytest.mark.ci("runs of a design")
# Saturation, and what the robot states ------------------------------------------------------------------
def test_each_motor_saturates_at_its_own_limit(robot_of: Named, setup_of: Callable[..., LoopSetup]) -> None:
    def jump(setup: LoopSetup) -> Any:  # with integrals at zero all inputs jump
        return setup.run(setup.tracking_controller, setup.start, 0.4)

    free = setup_of("planar-two-link", GOAL, START, estimator="none")
    peaks = np.abs(jump(free).inputs).max(axis=0)
    own = limited(robot_of("planar-two-link"), effort_limits=0.7 * peaks)
    kept = dataclasses.replace(free, robot=own)
    run = jump(kept)
    assert np.abs(run.inputs).max(axis=0) == pytest.approx(0.7 * peaks)
    use = measured("peak", kept.limits, [run])
    assert (use.share, use.joint in kept.joints) == (pytest.approx(1.0), True)
    stated = dataclasses.replace(kept, specification=Specification(estimator="none", saturation=np.inf))
    np.testing.assert_array_equal(jump(stated).inputs, jump(free).inputs)


def test_a_pose_that_a_joint_cannot_hold_within_its_own_limit_is_refused_before_any_work(
    robot_of: Named,
) -> None:
    robot, told = robot_of("planar-two-link"), []
    held = np.abs(robot.operating_point([1.2, 0.2])[1])
    assert held[1] < held[0]
    own = limited(robot, effort_limits=(2.0 * held[0], 0.9 * held[1]))
    with refused_with(InvalidInput, "joint 'elbow'", "hold") as refused:
        design(own, Specification(pose=(1.2, 0.2)), told.append)
    assert ROBOT in refused.value.found
    assert "placeholder" in refused.value.found
    assert "--peak-effort and --saturation (inf: " in error_text(refused.value)
    free = Specification(peak_effort=np.inf, saturation=np.inf)
    _refuse_early(own, free, np.array([1.2, 0.2]), np.zeros(2))
    assert len(told) == 1
    asked = Specification(pose=(1.2, 0.2), peak_effort=(100.0, 100.0), saturation=(100.0, 0.9 * held[1]))
    with pytest.raises(InvalidInput, match="`saturation`"):
        design(robot, asked)


def test_zero_at_the_command_line_is_no_limit_even_of_the_robot(tmp_path: Path) -> None:
    for name in ("peak_effort", "peak_speed", "saturation"):
        assert _value(FIELDS[name], "0") == np.inf
        assert _value(FIELDS[name], "") is None
    assert _value(FIELDS["duration"], "0") is None
    text = (Path(fh.catalogue()["planar-two-link"])).read_text(encoding="utf-8")
    (tmp_path / "arm.toml").write_text(
        text.replace("[[joint]]", "[[joint]]\neffort_limit = 9.0", 1), encoding="utf-8"
    )
    given = {"peak_effort": np.inf, "peak_speed": np.inf}
    asked = read_request(tmp_path / "arm.toml", settings=given)
    assert joint_limits(asked.robot, asked.specification).peak.tolist() == [np.inf, np.inf]
    assert joint_limits(asked.robot, Specification()).peak.tolist() == [9.0, np.inf]
    assert (asked.specification.peak_effort, asked.specification.peak_speed) == (np.inf, None)
    asked = read_request("planar-two-link", settings=given)
    assert asked.specification == resolved(asked.robot, Specification())


# Moves and bandwidths -------------------------------------------------------------------------------------
def test_a_move_is_slowed_until_every_joint_keeps_its_speed(robot_of: Named) -> None:
    robot, band = robot_of("planar-two-link"), np.array([6.0, 6.0])
    goal, start = np.array(GOAL), np.array(START)
    held = [robot.operating_point(at)[1] for at in (start, goal)]

    def planned(arm: Any, s: Specification) -> Any:
        return plan_move(arm, s, start, goal, band, 30.0, held)

    def fastest(plan: Any) -> np.ndarray:
        rates = plan.derivatives(np.arange(0.0, plan.duration, 1e-3), 1)[1]
        return np.abs(rates).max(axis=0)

    free = planned(robot, Specification())
    most = fastest(free) * (1.5, 0.8)
    for slow in (planned(limited(robot, speed_limits=most), Specification()),
                 planned(robot, Specification(peak_speed=tuple(most)))):  # fmt: skip
        assert np.all(fastest(slow) <= most)
        assert slow.duration > free.duration
    # until the motors give it, where no speed is limited
    strong = planned(limited(robot, effort_limits=(1e3, 1e3)), Specification())
    slow = planned(limited(robot, effort_limits=1.5 * np.abs(held).max(axis=0)), Specification())
    assert slow.duration > strong.duration == pytest.approx(free.duration)
    with refused_with(InvalidInput, "'elbow'", "faster", "0.001 rad/s"):
        planned(robot, Specification(peak_speed=(1.0, 1e-3)))


class _Model(_BandwidthSearch):
    """Peaks that grow with the square of the joints' own bandwidths, and a little with the first one's."""

    def __init__(self, limits: Any, size: np.ndarray, coupling: float = 0.0) -> None:
        self.limits, self.size, self.coupling = np.array([limits.peak, limits.speed]), size, coupling
        self.holding_input = np.zeros((1, 2))

    def tried(self, bandwidth: np.ndarray, before: Any = None) -> Any:
        inputs = self.size * bandwidth**2 + self.coupling * bandwidth[0] ** 2
        peaks = np.array([inputs, np.zeros(2)])
        return (None if (self.shares(peaks) > 1.0).any() else bandwidth), peaks


def test_only_the_joints_beyond_a_limit_become_slower(robot_of: Named) -> None:
    limits = joint_limits(robot_of("planar-two-link"), Specification(peak_effort=(10.0, 1.0)))
    search = _Model(limits, np.array([5.0, 2.0]))
    best, fractions = search.slower(np.ones(2), search.tried(np.ones(2))[1])
    assert fractions[0] == 1.0
    assert (1.0 - 2 * WIDTH) * np.sqrt(0.5) < fractions[1] <= np.sqrt(0.5)
    np.testing.assert_array_equal(best, fractions)
    search = _Model(limits, np.array([5.0, 0.0]), coupling=2.0)  # the second is moved by the first
    best, fractions = search.slower(np.ones(2), search.tried(np.ones(2))[1])
    assert best is not None
    assert fractions[0] < 1.0
    search = _Model(limits, np.array([5.0, 2.0 / (COARSE * MIN_FRACTION) ** 2]))
    assert search.slower(np.ones(2), search.tried(np.ones(2))[1])[0] is None


def test_a_bandwidth_that_sampled_robots_do_not_confirm_is_lowered(
    robot_of: Named, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits = joint_limits(robot_of("planar-two-link"), Specification(peak_effort=(10.0, 1.0)))
    search = _Model(limits, np.array([5.0, 1.0]))
    asked: list[np.ndarray] = []

    def peaks(best: Any) -> np.ndarray:
        asked.append(best)
        return np.array([1.1 * search.size * best**2, np.zeros(2)])

    monkeypatch.setattr(search, "peaks", peaks)
    best, fractions = search.confirmed(np.ones(2), np.ones(2), np.ones(2))  # type: ignore[arg-type]
    np.testing.assert_allclose(fractions, (1.0 - WIDTH) ** 2 * np.ones(2))
    np.testing.assert_array_equal(best, fractions)  # type: ignore[arg-type]
    assert len(asked) == 3
    search = _Model(limits, np.array([5.0, 1.0 / (0.9 * MIN_FRACTION) ** 2]))
    monkeypatch.setattr(search, "peaks", peaks)
    assert search.confirmed(np.ones(2), np.ones(2), np.ones(2))[0] is None  # type: ignore[arg-type]


# Sensors --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("quantisation", "steps"),
    [
        (1e-3, 1e-3),
        ("0.01deg, 0.2Nm", [np.radians(0.01), np.radians(0.01), 0.2]),
        ((1e-3, 2e-3, 0.5), [1e-3, 2e-3, 0.5]),
    ],
)
def test_steps_are_one_per_sensor_or_per_signal(robot_of: Named, quantisation: Any, steps: Any) -> None:
    robot, sensors = robot_of("planar-two-link"), ("motor_position", "joint_torque_elbow")
    s = Specification(measured=sensors, quantisation=quantisation)
    np.testing.assert_allclose(sensor_steps(robot, s.measured, s.quantisation, s.estimator), steps)
    if s.quantisation == 1e-3:
        return
    others = ("link_position_elbow", "motor_position_shoulder", "link_velocity")
    found = other_quantisation(robot, s.measured, s.quantisation, s.estimator, others)
    assert found == pytest.approx([steps[1], steps[0], 0.0, 0.0])


@pytest.mark.parametrize("steps", [(1e-3, 1e-3), (1e-3,) * 5])
def test_another_number_of_steps_is_refused(robot_of: Named, steps: Any) -> None:
    s = Specification(measured=("motor_position", "joint_torque", "link_position"), quantisation=steps)
    with refused_with(SpecificationError, "quantisation", "'motor_position_shoulder'") as refused:
        design(robot_of("planar-two-link"), s)
    assert error_text(refused.value).endswith("--quantisation 0.001,0.001,0.001")


@pytest.mark.parametrize(
    ("text", "wrong", "example"),
    [
        ("0.01deg", "0.01deg", "0.01deg,0.01deg,0.01Nm,0.01Nm"),
        ("0.1Nm,0.1Nm", "0.1Nm", "0.1deg,0.1deg,0.1Nm,0.1Nm"),
        ("1e-3,1rad/s", "1rad/s", "0.001,0.001,1Nm,1Nm"),
    ],
)
def test_a_unit_that_the_sensor_does_not_have_is_refused(
    robot_of: Named, text: str, wrong: str, example: str
) -> None:
    s = Specification(measured=("motor_position", "joint_torque"), quantisation=text)  # type: ignore[arg-type]
    with pytest.raises(SpecificationError) as refused:
        design(robot_of("planar-two-link"), s)
    assert (refused.value.field, refused.value.found.endswith(repr(wrong))) == ("quantisation", True)
    assert error_text(refused.value).endswith(f"--quantisation {example}")


def test_a_unit_that_no_sensor_has_is_refused_per_signal_too(robot_of: Named) -> None:
    robot, sensors = robot_of("planar-two-link"), ("motor_position",)
    with pytest.raises(SpecificationError, match=r"got '0.1Nm'"):
        check_stated_units(robot, Specification(measured=sensors, quantisation="0.1Nm,0.1Nm"))  # type: ignore[arg-type]
    check_stated_units(robot, Specification(measured=sensors, quantisation="1rad,1rad"))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("steps", "message"),
    [(1e29, "6.28319 rad"), ((1e-3, 1e7), "'joint_torque_elbow'")],
)
def test_a_step_beyond_the_whole_range_is_refused_before_any_work(
    robot_of: Named, steps: Any, message: str
) -> None:
    s = Specification(measured=("motor_position_elbow", "joint_torque_elbow"), quantisation=steps)
    with pytest.raises(SpecificationError) as refused:
        design(robot_of("planar-two-link"), s)
    assert message in str(refused.value)


@pytest.mark.ci("runs a design")
def test_the_loop_quantises_each_signal_by_its_own_step(setup_of: Callable[..., LoopSetup]) -> None:
    steps = (1e-3, 0.05)
    sensors = ("motor_position", "joint_torque")
    setup = setup_of("paper", (0.4,), (0.1,), measured=sensors, estimator="ekf", quantisation=steps)
    y = setup.step(0.05).run.signals["output"]
    for column, step in zip(y.T, steps):
        assert np.abs(column / step - np.round(column / step)).max() < 1e-9
