"""Motors that differ from joint to joint: the loop of mixed pairs is a robot's, and certificates hold for it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from benchmarks.workspace import masses
from benchmarks.workspace.robots import ROBOTS
from numpy.polynomial import chebyshev
from scipy.linalg import expm
from scipy.optimize import linear_sum_assignment

from flexhinf.design import Specification
from flexhinf.design.workspace.proof import sampled_pairs
from flexhinf.design.workspace.search import RANDOM
from flexhinf.design.workspace.setup import WorkspaceSetup
from flexhinf.modal.sampled_pairs import SampledPairs
from flexhinf.robot.workspace import workspace_of


class Mixed(NamedTuple):
    """What mixes k pairs, symmetric (k, k): Δ of masses, E of springs, N of K/J and Φ of B/J, 1/s."""

    masses: np.ndarray
    springs: np.ndarray
    motors: np.ndarray
    friction: np.ndarray


def sampled_loop(numbers: Mapping[str, Any], links: np.ndarray, errors: Mixed) -> np.ndarray:
    """The loop over a period of mixed pairs λ (k,), 1/s², by the numbers of a file alone, and in seconds.

    Its states are z, z′, w, w′, what filter or predictor say of these at the sample, the integral, and the last
    position. Law and filter know the motors, and neither masses nor springs as they are.
    """
    k, h, one = len(links), numbers["period"], np.eye(len(links))
    size = 10 * k if numbers["observer"] is not None or numbers["latency"] else 6 * k
    unit = np.eye(size)
    state, predicted, (total, last) = unit[: 4 * k], unit[4 * k : 8 * k], unit[-2 * k :].reshape(2, k, size)
    estimate, position = state, state[:k]
    if (observer := numbers["observer"]) is not None:
        seen, (low, high) = np.array(observer["seen"]), observer["range"]
        places = (2.0 * np.log(links) - low - high) / (high - low)
        series = chebyshev.chebval(np.clip(places, -1.0, 1.0), np.array(observer["table"]))
        gains = series.reshape(4, len(seen), k)[..., None] * one
        innovation = np.kron(seen, one) @ (state - predicted)
        estimate = predicted + gains.transpose(0, 2, 1, 3).reshape(4 * k, -1) @ innovation
        position = position if [1.0, 0.0, 0.0, 0.0] in seen.tolist() else estimate[:k]
    integral = total + 0.5 * h * (last + position)
    used, summed = (predicted, total) if numbers["latency"] else (estimate, integral)
    poles = np.array(numbers["poles"])[:, None]
    shares = np.vstack([poles / (links + poles), np.ones(k)])
    *gains, alike = (np.diag(row) for row in np.array(numbers["coefficients"]) @ shares)
    z, _, w, speed = used.reshape(4, k, size)
    held = -numbers["input"] * np.hstack(gains) @ np.vstack([used, summed])
    held += alike @ (numbers["motor"] * errors.motors @ (w - z) + errors.friction @ speed)
    moved = [
        _flow(numbers, errors, np.diag(links) + felt, one + springs) @ np.vstack([start, held])
        for start, felt, springs in (
            (state, np.sqrt(np.outer(links, links)) * errors.masses, errors.springs),
            (estimate, 0.0 * one, 0.0 * one),
        )
    ]
    return np.vstack([*moved[: size // k // 4], integral, position])


def _flow(numbers: Mapping[str, Any], errors: Mixed, inertia: np.ndarray, springs: np.ndarray) -> np.ndarray:
    """z, z′, w, w′ after a period by these and the motors' held accelerations (4k, 5k)."""
    k, one = len(inertia), np.eye(len(inertia))
    twist, rate = np.hstack([-one, 0.0 * one, one, 0.0 * one, 0.0 * one]), np.zeros((5 * k, 5 * k))
    rate[:k, k : 2 * k] = rate[2 * k : 3 * k, 3 * k : 4 * k] = rate[3 * k : 4 * k, 4 * k :] = one
    rate[k : 2 * k] = inertia @ springs @ twist
    rate[3 * k : 4 * k] -= numbers["motor"] * (one + errors.motors) @ springs @ twist
    rate[3 * k : 4 * k, 3 * k : 4 * k] -= numbers["damping"] * one + errors.friction
    return expm(numbers["period"] * rate)[: 4 * k]


def radius(numbers: Mapping[str, Any], links: np.ndarray, errors: Mixed) -> float:
    return float(np.abs(np.linalg.eigvals(sampled_loop(numbers, links, errors))).max())


def of_loop(pairs: SampledPairs) -> dict[str, Any]:
    """What a file says of law and loop."""
    pair, observer = pairs.gains.pair(1.0), None
    if pairs.filter is not None:
        seen, table, ends = pairs.filter.pair
        observer = {"seen": seen.tolist(), "table": table.tolist(), "range": [*ends]}
    return {
        "period": pairs.gains.period,
        "motor": pair.motor,
        "damping": pair.damping,
        "input": pair.input,
        "latency": pairs.latency,
        "poles": pairs.gains.poles.tolist(),
        "coefficients": pairs.gains.coefficients.tolist(),
        "observer": observer,
    }


@lru_cache
def scara(**stated: Any) -> WorkspaceSetup:
    """The law that a design tries first, with a specification."""
    robot = ROBOTS["scara"].robot()
    law, _ = masses.pairs_of(robot)
    return WorkspaceSetup(robot, Specification(**stated), workspace_of(robot), law, RANDOM[0])


def motors_at(setup: WorkspaceSetup, pose: np.ndarray) -> tuple[np.ndarray, Mixed]:
    """λ of a pose, and what unlike motors mix there."""
    law, joints, gains = setup.law, setup.law.joints, setup.gains
    root = np.sqrt(joints.stiffness)
    matrix = law.compliance.matrix(pose, law.plant.parameters.vector())
    links, frame = np.linalg.eigh(root[:, None] * matrix * root)
    rates = joints.stiffness / joints.motor_inertia, joints.motor_damping / joints.motor_inertia
    stiffness, friction = ((frame.T * rate) @ frame for rate in rates)
    one, none = np.eye(len(links)), np.zeros((len(links), len(links)))
    return links, Mixed(none, none, stiffness / gains.motor - one, friction - gains.damping * one)


@pytest.mark.oracle
@pytest.mark.parametrize(
    "stated",
    [
        {},
        {"latency": 0},
        {"measured": ("motor_position",)},
        {"measured": ("link_position", "motor_position")},
        {"estimator": "none"},
    ],
    ids=str,
)
def test_mixed_pairs_are_the_loop_of_a_robot_with_its_own_motors(stated: dict[str, Any]) -> None:
    """The other route is in joints: plant, slope of the law and gain of the filter at a pose, gravity without slope."""
    setup = scara(**stated)
    numbers = of_loop(sampled_pairs(setup))
    for pose in setup.workspace.sample(2, 3):
        links, motors = motors_at(setup, pose)
        assert np.ptp(np.linalg.eigvalsh(motors.motors)) > 1.5  # motors that differ
        found = np.linalg.eigvals(sampled_loop(numbers, links, motors))
        expected = setup.linear(pose, damped=False).closed_loop.multipliers
        apart = np.abs(found[:, None] - expected)  # the other loop has inputs that wait beside these
        assert apart[linear_sum_assignment(apart)].max() < 1e-10
