"""A tolerance as a channel: what a parameter changes is Δ t cᵀ, |Δ| ≤ 1, whatever its value within the tolerance."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flexhinf.designs.problem.presets import channels
from flexhinf.designs.problem.weights import UncertaintyChannel

pytestmark = pytest.mark.oracle


def _matrices(robot: Any, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[A B] (n, n + m) at rest, and G (n, 2 joints)."""
    a, b, g, _ = robot.plant().linearise(*robot.operating_point(pose))
    return np.hstack([a, b]), g


def _deltas(
    robot: Any, found: tuple[UncertaintyChannel, ...], pose: np.ndarray, values: dict[str, float]
) -> tuple[np.ndarray, float]:
    """Δ of each channel for the robot with these values, and the share of its change that no Δ explains."""
    nominal, torques = _matrices(robot, pose)
    changed, _ = _matrices(robot.with_values(values), pose)  # another robot, at its own rest
    as_torques = np.linalg.lstsq(torques, changed - nominal, rcond=None)[0]
    assert np.abs(torques @ as_torques - (changed - nominal)).max() <= 1e-9 * np.abs(nominal).max()
    table = np.array([np.outer(c.torque, np.append(c.by_state, c.by_input)).ravel() for c in found]).T
    wanted = as_torques.ravel()
    deltas = np.linalg.lstsq(table, wanted, rcond=None)[0]
    return deltas, float(np.linalg.norm(table @ deltas - wanted) / max(np.linalg.norm(wanted), 1e-300))


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(
    ("name", "pose"), [("paper", (0.4,)), ("quanser-rotflex", (0.3,)), ("vertical-rig", (2.0,))]
)
def test_of_a_single_link_each_parameter_is_covered_exactly(
    robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any], name: str, pose: tuple[float, ...]
) -> None:
    rng, at = np.random.default_rng(0), np.array(pose)
    looked = 0
    for parameter in robot_of(name).uncertain:
        robot = only_uncertain(robot_of(name), parameter.name)
        found = channels(robot, [at])
        if parameter.name == "inductance":  # not in the model of the synthesis
            assert found == ()
            continue
        looked += 1
        low, high = parameter.interval
        for value in (low, high, *rng.uniform(low, high, 5)):
            deltas, left = _deltas(robot, found, at, {parameter.name: value})
            assert left < 1e-8, parameter.name
            assert np.abs(deltas).max() <= 1.0 + 1e-8, parameter.name
        ends = np.array([_deltas(robot, found, at, {parameter.name: v})[0] for v in (low, high)])
        assert np.abs(ends).max(axis=0) == pytest.approx(1.0), parameter.name  # and no wider than it must be
    assert looked >= 6


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(
    "name", ["planar-two-link", "cart", pytest.param("seven-link", marks=pytest.mark.ci("seven joints"))]
)
def test_of_several_links_each_parameter_is_covered_but_for_its_bend(
    robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any], name: str
) -> None:
    """A mass changes the inertia of all links before it, and M⁻¹ bends: what is left is of second order."""
    rng, whole = np.random.default_rng(1), robot_of(name)
    at = np.array(whole.home)
    names = [p.name for p in whole.uncertain]
    for parameter in rng.choice(names, min(8, len(names)), replace=False):
        robot = only_uncertain(whole, parameter)
        found = channels(robot, [at])
        if not found:
            value = robot[parameter].interval[1]
            same, other = _matrices(robot, at)[0], _matrices(robot.with_values({parameter: value}), at)[0]
            assert np.abs(other - same).max() <= 1e-9 * np.abs(same).max(), parameter
            continue
        for value in (*robot[parameter].interval, rng.uniform(*robot[parameter].interval)):
            deltas, left = _deltas(robot, found, at, {parameter: value})
            assert left < 0.02, parameter
            assert np.abs(deltas).max() <= 1.0 + 2.0 * left + 1e-8, parameter


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize(
    "parameter", ["stiffness_elbow", "stiffness_shoulder", "rotor_inertia_elbow", "resistance_shoulder"]
)
def test_springs_and_motors_of_several_links_are_covered_exactly(
    robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any], parameter: str
) -> None:
    """About the rest of the robot as it is: a softer spring bends further, and holds the same weight."""
    robot, at = only_uncertain(robot_of("planar-two-link"), parameter), np.array([0.9, -0.7])
    found = channels(robot, [at])
    for value in np.linspace(*robot[parameter].interval, 5):
        deltas, left = _deltas(robot, found, at, {parameter: value})
        assert value == robot[parameter].value or left < 1e-7
        assert np.abs(deltas).max() <= 1.0 + 1e-7


def test_the_stiffness_is_the_channel_of_the_textbook(
    robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any]
) -> None:
    """t cᵀ = δ (−1, 1)ᵀ (q1 − q2) up to the sign that both may share: δ = 12 % of 100 N·m/rad."""
    (channel,) = channels(only_uncertain(robot_of("paper"), "stiffness"), [np.array([0.7])])
    wanted = 12.0 * np.outer([1.0, -1.0], [1.0, 0.0, -1.0, 0.0])
    found = np.outer(channel.torque, channel.by_state)
    assert min(np.abs(found - wanted).max(), np.abs(found + wanted).max()) < 1e-9
    assert channel.group == ("stiffness", "state")
    assert np.linalg.norm(channel.torque) == pytest.approx(np.linalg.norm(channel.by_state))


def test_each_parameter_counts_where_it_does_most(
    robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any]
) -> None:
    """The weight turns with cos q: at 0 it does most, at π/2 nothing."""
    robot = only_uncertain(robot_of("paper"), "mass")
    hanging, level = np.array([0.0]), np.array([np.pi / 2])
    assert channels(robot, [level]) == ()
    (both,), (one,) = channels(robot, [level, hanging]), channels(robot, [hanging])
    assert np.abs(both.torque) == pytest.approx(np.abs(one.torque))
    weight = 0.05 * 1.0 * 9.8 * 1.0
    assert np.abs(np.outer(one.torque, one.by_state)).max() == pytest.approx(weight, rel=1e-9)


def test_channels_of_one_quantity_share_a_group_over_the_joints(robot_of: Callable[[str], Any]) -> None:
    found = channels(robot_of("planar-two-link"), [np.array([0.4, 0.6])])
    groups = {channel.group for channel in found}
    assert ("stiffness", "state") in groups
    assert ("resistance", "input") in groups
    assert not any("shoulder" in quantity or "elbow" in quantity for quantity, _ in groups)
    for channel in found:
        assert np.any(channel.by_state) != np.any(channel.by_input)
        assert channel.by_state.shape == (8,)
        assert channel.by_input.shape == (2,)


def test_a_robot_without_tolerances_has_no_channels(
    robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any]
) -> None:
    assert channels(only_uncertain(robot_of("planar-two-link")), [np.array([0.4, 0.6])]) == ()


def test_several_parameters_at_once_add_up_to_first_order(
    robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any]
) -> None:
    """With tolerances a tenth as wide, what the sum of the channels misses shrinks a hundredfold."""
    from dataclasses import replace

    names = ("stiffness", "motor_inertia", "resistance", "friction", "link_inertia")
    whole, at = only_uncertain(robot_of("paper"), *names), np.array([0.4])
    rng = np.random.default_rng(2)
    signs = dict(zip(names, rng.choice([-1.0, 1.0], len(names))))
    missed = []
    for share in (1.0, 0.1):
        shrunk = [replace(p, tolerance=share * p.tolerance) for p in whole.parameters]
        robot = replace(whole, parameters=tuple(shrunk))
        values = {name: robot[name].at(sign) for name, sign in signs.items()}
        nominal, torques = _matrices(robot, at)
        changed, _ = _matrices(robot.with_values(values), at)
        total = np.zeros_like(nominal)
        for name, sign in signs.items():
            one = only_uncertain(robot, name)
            found = channels(one, [at])
            deltas, _ = _deltas(one, found, at, {name: one[name].at(sign)})
            total += sum(
                d * torques @ np.outer(c.torque, np.append(c.by_state, c.by_input))
                for d, c in zip(deltas, found)
            )
        missed.append(np.abs(changed - nominal - total).max())
    assert missed[1] == pytest.approx(0.01 * missed[0], rel=0.3)
    assert missed[0] > 0.0
