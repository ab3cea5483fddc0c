"""Bandwidth and damping against python-control's frequency responses and eigenvalues by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from flexhinf.designs.problem import weights
from flexhinf.designs.problem.weights import LinearFamily, behaviour_of

pytestmark = pytest.mark.oracle


def _family(robot: Any, members: int = 6) -> LinearFamily:
    return LinearFamily.of(robot, np.array(robot.home), members)


def _gain(family: LinearFamily, rng: np.random.Generator, price: float) -> np.ndarray:
    """LQ-optimal for random weights of the nominal robot, in the units of its states."""
    a, b = family.a[0], family.b[0]
    n, m = b.shape
    size = np.repeat([1.0, 0.05, 1.0, 0.05, 3.0], m) * rng.uniform(0.3, 3.0, n)
    p = solve_continuous_are(a, b, np.diag(size**2), price * np.eye(m))
    return -b.T @ p / price


def test_of_many_gains_the_plant_is_sampled_once(
    robot_of: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    import control

    family, rng = replace(_family(robot_of("paper"), 0), period=2e-3), np.random.default_rng(2)
    sampled = Mock(wraps=weights.exponential)
    monkeypatch.setattr(weights, "exponential", sampled)
    for price in (1e-3, 1e-2, 1e-1):
        behaviour_of(family, _gain(family, rng, price))
    assert sampled.call_count == 1
    phi, held = family.sampled
    whole = control.ss(family.a[0], family.b[0], np.eye(len(phi)), 0).sample(2e-3)
    assert phi == pytest.approx(whole.A, rel=1e-9, abs=1e-9)
    assert held == pytest.approx(whole.B, rel=1e-9, abs=1e-9)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize(
    ("name", "price"),
    [
        ("paper", 1e-3),
        ("quanser-rotflex", 0.1),
        ("cart", 1e-6),
        ("planar-two-link", 1e-3),
        pytest.param("seven-link", 1e-6, marks=pytest.mark.ci("responses of seven joints")),
    ],
)
def test_each_bandwidth_is_the_first_crossing_of_the_frequency_response(
    robot_of: Callable[[str], Any], name: str, price: float
) -> None:
    import control

    rng, family = np.random.default_rng(1), _family(robot_of(name), 4)
    gain, joints = _gain(family, rng, price), len(family.robot.joint_names)
    found = behaviour_of(family, gain)
    n = family.a.shape[1]
    command = np.vstack([np.zeros((n - joints, joints)), -np.eye(joints)])
    crossings = []
    for a, b in zip(family.a, family.b):
        loop = control.ss(a + b @ gain, command, np.eye(joints, n), np.zeros((joints, joints)))
        slowest = np.abs(np.linalg.eigvals(a + b @ gain)).min()
        grid = np.geomspace(1e-2 * slowest, 1e3 * slowest, 4000)
        sizes = np.abs(loop(1j * grid))
        assert loop(0.0) == pytest.approx(np.eye(joints), abs=1e-6)  # the integral: it follows at rest
        first = [int(np.argmax(sizes[j, j] < np.sqrt(0.5))) if joints > 1 else int(np.argmax(sizes < np.sqrt(0.5)))
                 for j in range(joints)]  # fmt: skip
        assert min(first) > 0
        crossings.append(np.sqrt(grid[first] * grid[np.array(first) - 1]))
    assert found.bandwidth == pytest.approx(np.min(crossings, axis=0), rel=4e-3)


@pytest.mark.parametrize("name", ["paper", "cart", "planar-two-link"])
def test_the_damping_is_the_smallest_of_the_members_vibrations(
    robot_of: Callable[[str], Any], name: str
) -> None:
    """Vibrations told apart by hand: the fastest pair of each joint."""
    rng, family = np.random.default_rng(2), _family(robot_of(name))
    gain = 0.0 * _gain(family, rng, 1.0)
    joints = len(family.robot.joint_names)
    gain[:, :joints] = -np.diag(
        1e-3 * _stiffness_per_input(family)
    )  # hardly anything: the robot's own vibrations
    gain[:, -joints:] = 1e-2 * gain[:, :joints]
    found = behaviour_of(family, gain)
    ratios = []
    for a, b in zip(family.a, family.b):
        values = np.linalg.eigvals(a + b @ gain)
        assert values.real.max() < 0.0
        pairs = sorted((v for v in values if v.imag > 1e-6), key=abs)[-joints:]
        ratios.append(min(-v.real / abs(v) for v in pairs))
    assert found.damping == pytest.approx(min(ratios), rel=1e-9)
    assert found.nominal_damping == pytest.approx(ratios[0], rel=1e-9)
    assert found.damping < found.nominal_damping


def _stiffness_per_input(family: LinearFamily) -> np.ndarray:
    """Springs in units of the input: ∂q̈2/∂q1 over ∂q̈2/∂u."""
    a, b = family.a[0], family.b[0]
    n = len(family.robot.joint_names)
    return np.diag(a[3 * n : 4 * n, :n]) / np.diag(b[3 * n : 4 * n])


def test_one_member_that_grows_makes_all_unstable(robot_of: Callable[[str], Any]) -> None:
    """A gain that only the lighter members bear: found between one that all bear and one that none does."""
    family = _family(robot_of("paper"), 32)
    a, b = family.a[0], family.b[0]
    p = solve_continuous_are(a, b, np.diag([60.0, 0, 0, 0, 300.0]) ** 2, np.eye(1))
    good = -b.T @ p
    bad = good * np.array([1.0, 1.0, 1.0, 0.2, 1.0])
    growth = []
    for share in np.linspace(0.0, 1.0, 41):
        gain = (1.0 - share) * good + share * bad
        growth.append([np.linalg.eigvals(a + b @ gain).real.max() for a, b in zip(family.a, family.b)])
        found, worst = behaviour_of(family, gain), max(growth[-1])
        assert (found.damping == -np.inf) is bool(worst >= 0.0)
        assert (found.nominal_damping == -np.inf) is bool(growth[-1][0] >= 0.0)
        assert np.all(found.bandwidth == 0.0) == (worst >= 0.0)
    assert any(row[0] < 0.0 <= max(row) for row in growth)


def test_without_feedback_nothing_is_followed(robot_of: Callable[[str], Any]) -> None:
    family = _family(robot_of("planar-two-link"))
    found = behaviour_of(family, np.zeros((2, 10)))
    assert found.damping == -np.inf
    assert found.bandwidth.tolist() == [0.0, 0.0]


def test_a_loop_that_never_vibrates_has_no_damping_to_miss(robot_of: Callable[[str], Any]) -> None:
    """Five real poles, placed: no vibration is left."""
    import control

    family = _family(robot_of("paper"), 0)
    a, b = family.a[0], family.b[0]
    gain = -control.place(a, b, [-3.0, -4.0, -5.0, -6.0, -7.0])
    found = behaviour_of(family, np.asarray(gain))
    assert found.damping == np.inf
    poles = np.array([3.0, 4.0, 5.0, 6.0, 7.0])
    w = found.bandwidth[0]  # the zeros of command → link are at infinity: q/r = Π p / Π (s + p)
    assert np.prod(poles / np.hypot(poles, w)) == pytest.approx(np.sqrt(0.5), rel=1e-3)
