"""Members of a family: each the robot at one corner of its tolerances, about its own rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from flexhinf.designs.problem.weights import MEMBERS, LinearFamily

pytestmark = pytest.mark.oracle


def _slopes(plant: Any, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B and G by central differences of the plant's rate."""
    point = np.concatenate([x, u, np.zeros(len(plant.disturbances))])
    n, m = len(x), len(u)

    def rate(v: np.ndarray) -> np.ndarray:
        return plant.derivative(v[:n], v[n : n + m], v[n + m :])

    columns = []
    for k in range(len(point)):
        step = np.zeros(len(point))
        step[k] = 1e-5 * max(1.0, abs(point[k]))
        columns.append((rate(point + step) - rate(point - step)) / (2.0 * step[k]))
    slope = np.array(columns).T
    return slope[:, :n], slope[:, n : n + m], slope[:, n + m :]


def _rest(plant: Any, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motor positions and inputs for which nothing moves with the links at q: accelerations are affine in both."""
    n = len(q)

    def accelerations(v: np.ndarray) -> np.ndarray:
        rate = plant.derivative(np.concatenate([q, np.zeros(n), v[:n], np.zeros(n)]), v[n:])
        return np.concatenate([rate[n : 2 * n], rate[3 * n :]])

    free = accelerations(np.zeros(2 * n))
    slope = np.array([accelerations(unit) - free for unit in np.eye(2 * n)]).T
    found = np.linalg.solve(slope, -free)
    return np.concatenate([q, np.zeros(n), found[:n], np.zeros(n)]), found[n:]


@pytest.mark.parametrize(
    ("name", "goal", "uncertain"),
    [
        ("paper", (0.8,), ("mass", "stiffness", "resistance", "back_emf_constant")),
        ("planar-two-link", (0.4, 0.6), ("mass_elbow", "stiffness_shoulder", "rotor_inertia_elbow")),
        ("cart", (0.1, 0.7), ("mass_belt", "stiffness_arm", "friction_belt")),
    ],
)
def test_members_are_all_corners_linearised_by_differences_at_their_own_rests(
    robot_of: Callable[[str], Any],
    only_uncertain: Callable[..., Any],
    name: str,
    goal: tuple[float, ...],
    uncertain: tuple[str, ...],
) -> None:
    robot = only_uncertain(robot_of(name), *uncertain)
    family = LinearFamily.of(robot, np.array(goal))
    n, joints = 4 * len(goal), len(goal)
    assert len(family.a) == len(family.b) == 1 + 2 ** len(uncertain)
    wanted = [{}, *(dict(zip(uncertain, signs)) for signs in product([-1.0, 1.0], repeat=len(uncertain)))]
    found = list(range(len(family.a)))
    for k, signs in enumerate(wanted):
        values = {p.name: p.at(signs.get(p.name, 0.0)) for p in robot.parameters}
        changed = robot.with_values(values)  # a robot of its own, not the nominal plant with other parameters
        plant = changed.plant()
        a, b, _ = _slopes(plant, *_rest(plant, np.array(goal)))
        if not signs:  # the law of the nominal robot acts in samples
            held = np.zeros((n + 2 * joints, n + 2 * joints))
            held[:n, :n], held[:n, n + joints :], held[n : n + joints, :joints] = a, b, np.eye(joints)
            whole = expm(1e-2 * held)[: n + joints]
            ours = np.hstack(replace(family, period=1e-2).sampled)
            np.testing.assert_allclose(ours, whole, rtol=1e-5, atol=1e-6 * np.abs(whole).max())
        scale = np.abs(a).max()
        matches = [
            i for i in found if np.abs(family.a[i, :n, :n] - a).max() < 1e-6 * scale
            and np.abs(family.b[i, :n] - b).max() < 1e-6 * np.abs(b).max()
        ]  # fmt: skip
        assert len(matches) == 1, signs
        found.remove(matches[0])
        assert k > 0 or matches == [0]
    assert family.a[:, n:, :joints] == pytest.approx(
        np.broadcast_to(np.eye(joints), (len(family.a), joints, joints))
    )
    assert not np.any(family.a[:, n:, joints:])
    assert not np.any(family.a[:, :, n:])
    assert not np.any(family.b[:, n:])


def test_torques_enter_where_the_plant_has_them(robot_of: Callable[[str], Any]) -> None:
    robot = robot_of("planar-two-link")
    family, rest = LinearFamily.of(robot, np.array([0.4, 0.6]), members=0), robot.operating_point([0.4, 0.6])
    assert family.torques[:8] == pytest.approx(_slopes(robot.plant(), *rest)[2], rel=1e-6, abs=1e-6)
    assert not np.any(family.torques[8:])
    assert len(family.a) == 1


def test_of_many_parameters_corners_are_drawn_the_same_every_time(robot_of: Callable[[str], Any]) -> None:
    robot = robot_of("paper")
    one, two = (LinearFamily.of(robot, np.array([0.3])) for _ in range(2))
    assert len(one.a) == 1 + MEMBERS
    assert np.array_equal(one.a, two.a)
    assert np.array_equal(one.b, two.b)
    springs = -one.a[:, 1, 2] / one.a[:, 1, 0]  # nothing of them is left nominal
    assert len(np.unique(one.a, axis=0)) > MEMBERS - 2
    assert np.all(one.a[1:, 1, 2] != one.a[0, 1, 2])
    assert np.all(springs[1:] != springs[0])


def test_a_robot_without_tolerances_is_a_family_of_one(
    robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any]
) -> None:
    assert len(LinearFamily.of(only_uncertain(robot_of("paper")), np.array([0.3])).a) == 1
