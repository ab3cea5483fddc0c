"""Motors that saturate all at once: unlike motors, random holds, jumps of the command, for arms of several joints."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_are

import flexhinf as fh
from flexhinf.loop.controller.data import integral_relief
from flexhinf.loop.controller.step import RELIEF
from flexhinf.plant import Plant

H = 2e-3


class Arm:
    """Rigid joints whose inertia couples them, N·m per rad/s², and the law of a regulator that weighs each motor in
    units of its limit; the law is about a moving reference."""

    def __init__(self, linear: Any, mass: np.ndarray, effort: np.ndarray, bandwidth: float = 20.0) -> None:
        n = self.n = len(mass)
        self.mass, self.bandwidth = mass, bandwidth
        self.effort, none = effort, np.zeros((n, n))
        flow = np.block([[none, np.eye(n)], [none, none]])
        push = np.vstack([none, np.linalg.inv(mass)])
        whole = expm(H * np.block([[flow, push], [np.zeros((n, 3 * n))]]))
        self.step = whole[: 2 * n, : 2 * n], whole[: 2 * n, 2 * n :]
        a = np.block([[flow, np.zeros((2 * n, n))], [np.eye(n), np.zeros((n, 2 * n))]])
        b = np.vstack([push, none])
        # Diagonal weights: the fastest that a motor reaches alone sets how much an error may cost.
        ease = np.diag(mass) / effort
        weights = np.concatenate([bandwidth**4 * ease**2, 0.0 * ease, bandwidth**6 * ease**2])
        p = solve_continuous_are(a, b, np.diag(weights), np.diag(effort**-2.0))
        self.gain = -np.diag(effort**2.0) @ b.T @ p
        names = [f"{kind}_{k}" for kind in ("angle", "speed") for k in range(n)]
        inputs = tuple(f"torque_{k}" for k in range(n))
        self.plant = Plant(
            lambda x, u, d, p: flow @ x + push @ u, lambda x, u, p: x[:n], tuple(names), inputs
        )
        self.law = linear((*names, *(f"angle_{k}_integral" for k in range(n))), inputs, self.gain)

    def run(
        self, goals: np.ndarray, held: tuple[int, int] = (0, 0), strong: float = 1.0, weight: Any = 0.0,
        stop: float = np.inf, control: Any = None,
    ) -> np.ndarray:  # fmt: skip
        """Angles (N, n) under commands (N, n), held by brakes from and to a sample; `strong` scales the motors'
        limits, `weight` (n,) is a load that nobody knows, N·m, and no joint goes beyond ±`stop`."""
        control = control or fh.Controller(self.law, None, H, strong * self.effort, moving=True)
        x, angles = np.zeros(2 * self.n), []
        for k, goal in enumerate(goals):
            angles.append(x[: self.n])
            u = control.step(x, np.concatenate([goal, np.zeros(2 * self.n)]))
            x = self.step[0] @ x + self.step[1] @ (u - weight)
            x = np.concatenate([angles[-1], np.zeros(self.n)]) if held[0] <= k < held[1] else x
            speed = np.where(np.abs(x[: self.n]) > stop, 0.0, x[self.n :])
            x = np.concatenate([np.clip(x[: self.n], -stop, stop), speed])
        return np.array(angles)


class Rival:
    """A PD of each joint alone, critically damped and as fast as the law, whose integral stands still at a limit."""

    def __init__(self, arm: Arm, strong: float) -> None:
        self.limit, inertia = strong * arm.effort, np.diag(arm.mass)
        self.gains = inertia * arm.bandwidth**2, 2.0 * inertia * arm.bandwidth
        self.integral, self.n, self.rate = np.zeros(arm.n), arm.n, 0.2 * arm.bandwidth * H

    def step(self, x: np.ndarray, r: np.ndarray) -> np.ndarray:
        error = r[: self.n] - x[: self.n]
        wanted = self.gains[0] * (error + self.integral) - self.gains[1] * x[self.n :]
        u = np.clip(wanted, -self.limit, self.limit)
        self.integral = self.integral + np.where(u == wanted, self.rate * error, 0.0)
        return u


def chain(inertias: np.ndarray, coupling: float) -> np.ndarray:
    """A positive definite inertia matrix whose first joints carry the others."""
    tails = np.cumsum(inertias[::-1])[::-1]
    size = len(inertias)
    mixed = np.array([[tails[max(i, j)] for j in range(size)] for i in range(size)])
    return coupling * mixed + (1.0 - coupling) * np.diag(np.diag(mixed))


#: Two motors of 100 and 7 N·m, a SCARA with a small wrist, a palletiser with joints alike, and an arm of five joints.
ARMS = {
    "two": (np.array([3.0, 0.01]), np.array([100.0, 7.0]), 0.7),
    "scara": (np.array([2.4, 0.5, 0.012]), np.array([160.0, 60.0, 7.0]), 0.6),
    "palletiser": (np.array([40.0, 30.0, 20.0, 0.5]), np.array([900.0, 800.0, 700.0, 40.0]), 0.8),
    "five": (np.array([3.0, 2.0, 0.6, 0.05, 0.01]), np.array([180.0, 180.0, 110.0, 40.0, 12.0]), 0.7),
}


@pytest.fixture(scope="module", params=list(ARMS))
def arm(request: pytest.FixtureRequest, made: Any) -> Arm:
    inertias, effort, coupling = ARMS[request.param]
    return Arm(made.LinearLaw, chain(inertias, coupling), effort)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("what", ["brakes", "jump", "undersized", "stops", "back"])
def test_all_motors_at_their_limits_at_once(arm: Arm, what: str) -> None:
    """All joints are commanded elsewhere at once: with brakes closed for half a second at a random instant, as they
    are, with motors of 30 %, against stops before a first goal, or back and forth. No joint goes further beyond than
    it was to go, nor in the worst case a quarter more than with a PD, and all come to rest at the goal. The speed that
    a jump makes is not as good: up to two and a half times that of the PD, where a joint is light."""
    rng, worst = np.random.default_rng(4), np.zeros((2, 2))
    for _ in range(3):
        goal = rng.choice([-1.0, 1.0], arm.n) * rng.uniform(0.3, 1.0, arm.n)
        begin = int(rng.integers(0, 40)) if what == "brakes" else 0
        held = (begin, begin + 250 * (what == "brakes"))
        strong, goals = 0.3 if what == "undersized" else 1.0, np.tile(goal, (2400, 1))
        goals[:800] *= 2.0 if what == "stops" else 1.0
        goals[150:300] *= -1.0 if what == "back" else 1.0
        stop = 1.1 * np.abs(goal).max() if what == "stops" else np.inf
        for row, control in enumerate((None, Rival(arm, strong))):
            angles = arm.run(goals, held, strong, stop=stop, control=control)
            beyond, speed = (np.sign(goal) * (angles - goals)).max(), np.abs(np.diff(angles, axis=0)).max()
            worst[row] = np.maximum(worst[row], (beyond, speed))
            assert control or np.abs(angles[-100:] - goal).max() < 2e-3
    assert worst[0, 0] < 1.0 or what == "back"  # the command itself turns by twice its way
    assert np.all(worst[0] < np.array([1.25, 2.5]) * worst[1])


def test_a_joint_far_from_its_goal_does_not_drop_what_others_hold(arm: Arm) -> None:
    """The first motor alone is at its limit; the others hold an unknown load of 30 % of theirs by their integrals."""
    load = 0.3 * arm.effort * (np.arange(arm.n) > 0)
    goals = np.zeros((1500, arm.n))
    goals[700:, 0] = 0.5
    angles = arm.run(goals, weight=load)
    assert np.abs(angles[650:, 1:] - angles[650, 1:]).max() < 0.09
    assert angles[:, 0].max() < 0.55


@pytest.mark.quick_cases(2)
def test_integrals_wait_at_a_limit_for_as_long_as_it_lasts(arm: Arm) -> None:
    """Brakes closed for 4 s leave no more behind than for 0.4 s."""
    goal = np.tile(np.full(arm.n, 0.4), (3200, 1))
    short, long = (arm.run(goal, (0, held))[held : held + 1000] for held in (200, 2000))
    np.testing.assert_allclose(long, short, atol=2e-3)


# What is taken back of which integral ---------------------------------------------------------------
def joints(rng: np.random.Generator, n: int) -> np.ndarray:
    """Slopes of a law of joints: a diagonal times a positive definite matrix; in units that differ by 1e6."""
    root = rng.standard_normal((n, n))
    return -(10.0 ** rng.uniform(-3, 3, (n, 1))) * (root @ root.T + 0.05 * np.eye(n))


@pytest.mark.parametrize("seed", range(4))
def test_every_integral_has_the_input_of_its_own_joint(seed: int) -> None:
    """Whatever the order of the inputs, and the units of inputs and integrals."""
    rng = np.random.default_rng(seed)
    n = 2 + seed
    slope, order = joints(rng, n) * 10.0 ** rng.uniform(-3, 3, n), rng.permutation(n)
    relief = integral_relief(slope[order], 10.0 ** rng.uniform(-2, 2, n))
    np.testing.assert_array_equal(relief != 0.0, np.eye(n)[:, order] != 0.0)
    np.testing.assert_allclose((relief @ slope[order]).diagonal(), RELIEF)


@pytest.mark.parametrize("seed", range(4))
def test_no_set_of_motors_at_limits_drives_the_integrals(seed: int) -> None:
    """The map e - relief (K e - sat(K e)) brings no two integrals further apart, in the norm of the joints' matrix."""
    rng = np.random.default_rng(seed)
    n = 2 + seed
    slope = joints(rng, n)
    relief, limit = integral_relief(slope, np.ones(n)), np.abs(slope).sum(axis=1)
    symmetric = slope / slope.diagonal()[:, None]  # times a diagonal, which makes it symmetric:
    scale = symmetric[:, 0] / symmetric[0]
    norm = np.linalg.cholesky(symmetric / scale[:, None]).T
    for _ in range(50):
        e = rng.standard_normal((2, n, 1)) * 10.0 ** rng.uniform(-1, 1, (2, n, 1))
        wanted = slope @ e
        after = e - relief @ (wanted - np.clip(wanted, -limit[:, None], limit[:, None]))
        apart, before = (np.linalg.norm(norm @ (pair[0] - pair[1])) for pair in (after, e))
        assert apart <= before * (1.0 + 1e-12)


def test_integrals_and_inputs_of_other_numbers() -> None:
    """More inputs, more integrals, an integral that moves nothing, and none at all."""
    column = np.array([[-4.0], [30.0]])
    np.testing.assert_allclose(integral_relief(column, np.array([1.0, 100.0])), [[-RELIEF / 4.0, 0.0]])
    np.testing.assert_allclose(integral_relief(column.T, np.ones(1)), [[-RELIEF / 4.0], [RELIEF / 30.0]])
    np.testing.assert_array_equal(integral_relief(np.zeros((2, 1)), np.full(2, np.inf)), np.zeros((1, 2)))
    assert integral_relief(np.zeros((2, 0)), np.ones(2)).shape == (0, 2)
    many = integral_relief(np.ones((1, 20)), np.ones(1))
    np.testing.assert_allclose(many.sum(), 1.0)  # of one input, no more than all of its excess
