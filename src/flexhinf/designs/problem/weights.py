"""The linear part of a design at its goal: the nominal robot and its H∞ gain, and robots within the tolerances.

A search evaluates many gains, so the linearisations are computed once: ẋ = A x + B u + G d of every member, with the
integrals of the tracking errors as last states, in deviations from each member's own equilibrium.

Weights for a bandwidth and a damping come from two nested searches over ω and ζ, see docs/weights.md. A common ζ damps
most vibrations more than required, above all those of light links, and the motors then amplify the estimator's noise.
So at the end the ζ of each joint is lowered to the value that its own vibration needs. All members of the family count:
the nominal robot and corners of its tolerances.

The preset `robust` covers tolerances with constant scalings s_i, by the inequality of docs/weights.md [shen1995].
Channel i has the input matrix g_i/s_i and the output s_i z_i. The channels do not scale with γ: in a problem of level γ
they enter with γ g_i/s_i. The s_i, one for each channel, are found on the linear part: they balance input and output of
the channel, first in the nominal loop, then a few times in the resulting loop.
"""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from flexhinf.analysis.linear_loop import exponential
from flexhinf.analysis.modes import JointScales, sampled_modes
from flexhinf.analysis.optimiser import bisected
from flexhinf.errors import FlexhinfError, InvalidInput, NoFeasibleGamma, refuse_if
from flexhinf.hinf import HJISolution, linear_law
from flexhinf.hinf.linear_part import LinearPart, is_feasible, linear_smallest_gamma
from flexhinf.loop.simulation.metrics import LASTING
from flexhinf.plant import PolynomialPlant
from flexhinf.robot import Robot
from flexhinf.robot.modes import Energy, modes_of, stiffness_and_inertia

#: Number of tolerance corners in a search, besides the nominal robot; and number of corners from which the worst ones
#: for the first weights join the second search.
MEMBERS, MANY = 32, 400

#: Relative width at which the bisection for γ* ends during a search.
ROUGH = 1e-3


@dataclass(frozen=True, eq=False)
class LinearFamily:
    """Linearisations of N robots at a goal, the nominal one first, with one integral per joint as last states."""

    a: np.ndarray  # (N, n, n)
    b: np.ndarray  # (N, n, m)
    torques: np.ndarray  # (n, 2 joints), where torques at links and motors enter the nominal robot
    energy: Energy  # nominal, by which vibrations are named
    robot: Robot
    goal: np.ndarray  # (n,), link positions, rad or m
    period: float = 0.0  # s, of the samples at which the law of the nominal robot acts; 0: always

    @cached_property
    def sampled(self) -> tuple[np.ndarray, np.ndarray]:
        """(Φ, Γ) of the nominal robot over one period with a constant input."""
        return exponential(self.a[0], self.b[0], self.period)

    @cached_property
    def many(self) -> LinearFamily:
        """The family with `MANY` corners, from which the worst ones for the first weights are taken."""
        return LinearFamily.of(self.robot, self.goal, MANY, seed=1)

    @staticmethod
    def of(
        robot: Robot, goal: np.ndarray, members: int = MEMBERS, seed: int = 0, period: float = 0.0
    ) -> LinearFamily:
        """Family of a robot at a pose (n,), with corners of its tolerances: all corners if there are at most `members`,
        else a random choice with this seed, which does not depend on the order of the parameters."""
        plant, equilibrium = robot.plant(), robot.operating_point(goal)
        joints, n = len(robot.joint_names), plant.n
        matrices = [plant.linearise(*equilibrium)]  # traced once, shared by all members
        names = sorted(parameter.name for parameter in robot.uncertain) if members else []
        signs = np.random.default_rng(seed).choice([-1.0, 1.0], (members, len(names)))
        if 2 ** len(names) <= members:
            bits = cast("np.ndarray", np.arange(2 ** len(names))[:, None] >> np.arange(len(names)))
            signs = 1.0 - 2.0 * (bits & 1)
        for row in signs.tolist() if names else ():
            values = plant.parameters.known(robot.corner(dict(zip(names, row))))
            matrices.append(
                plant.with_parameters(**values).linearise(*robot.operating_point(goal, parameters=values))
            )
        a = np.zeros((len(matrices), n + joints, n + joints))
        b = np.zeros((len(matrices), n + joints, len(plant.inputs)))
        a[:, :n, :n], b[:, :n] = [each[0] for each in matrices], [each[1] for each in matrices]
        a[:, n:, :joints] = np.eye(joints)
        torques = np.pad(matrices[0][2], ((0, joints), (0, 0)))
        return LinearFamily(a, b, torques, stiffness_and_inertia(plant, equilibrium), robot, goal, period)


#: Range of the frequency grid beyond the fastest and the slowest mode of the loop, and points per decade.
PER_DECADE = 60

#: A sampled mode with a smaller multiplier is gone too soon to oscillate, see `LASTING`.
SMALLEST_MULTIPLIER = float(np.exp(-1.0 / LASTING))


@dataclass(frozen=True, eq=False)
class Behaviour:
    """Bandwidth and damping of a family of loops: the smallest of all members."""

    bandwidth: np.ndarray  # (n,), of each joint, rad/s
    damping: float  # smallest damping ratio; infinite where nothing oscillates, −∞ for an unstable loop
    nominal_damping: float  # of the nominal robot
    joint_damping: np.ndarray  # (n,), of the vibrations mainly in each spring; infinite without any
    worst: list[int]  # the members with the smallest damping, and the smallest bandwidth of each joint


def behaviour_of(family: LinearFamily, gain: np.ndarray) -> Behaviour:
    """Behaviour of the loops with u = u* + K x, K (m, n)."""
    loops, joints = family.a + family.b @ gain, len(family.robot.joint_names)
    modes = [modes_of(loop, family.robot.joint_names, *family.energy) for loop in loops]
    if family.period:
        phi, by_input = family.sampled
        names, every = (family.robot.joint_names, *family.energy), np.linalg.eig(phi + by_input @ gain)
        modes[0] = sampled_modes(*every, family.period, *names, lasting=SMALLEST_MULTIPLIER)
    stable = [all(mode.stable for mode in each) for each in modes]
    oscillations = [[mode.damping for mode in each if mode.eigenvalue.imag > 0.0] for each in modes]
    damping = [min(each, default=np.inf) if decays else -np.inf for each, decays in zip(oscillations, stable)]
    bandwidth, worst = np.zeros(joints), [int(np.argmin(damping))]
    if min(damping) > -np.inf:
        every = _bandwidths(loops, joints)
        bandwidth, worst = every.min(axis=0), worst + np.argmin(every, axis=0).tolist()
    vibrations = [mode for each in modes for mode in each if mode.vibration]
    own = [
        min((m.damping for m in vibrations if m.joint == name), default=np.inf)
        for name in family.robot.joint_names
    ]
    return Behaviour(bandwidth, min(damping), damping[0], np.array(own), worst)


def _bandwidths(loops: np.ndarray, joints: int) -> np.ndarray:
    """Bandwidths, (N, joints): where |q_j / command_j| first falls below 1/√2, from above zero."""
    (values, vectors), n = np.linalg.eig(loops), loops.shape[1]
    command = np.broadcast_to(0.0 - np.eye(n, joints, joints - n), (len(loops), n, joints))
    residues = vectors[:, :joints].transpose(0, 2, 1) * np.linalg.solve(vectors, command)  # (N, mode, joint)
    low, high = 0.02 * np.abs(values).min(), 5.0 * np.abs(values).max()
    count = max(2, int(PER_DECADE * np.log10(high / low)))
    frequencies = cast("np.ndarray", np.geomspace(low, high, count))
    limit, logs, crossings = np.sqrt(0.5), np.log(frequencies), np.zeros((len(loops), joints))
    for k, member in enumerate(residues):
        response = np.abs((1.0 / (1j * frequencies[:, None] - values[k])) @ member)
        for joint, row in enumerate(response.T):
            below = np.flatnonzero(row < limit)
            if not len(below):
                crossings[k, joint] = frequencies[-1]
            elif (i := below[0]) > 0:  # interpolated in log scales; 0 where it begins below
                fraction = np.log(row[i - 1] / limit) / np.log(row[i - 1] / row[i])
                crossings[k, joint] = np.exp(logs[i - 1] + fraction * (logs[i] - logs[i - 1]))
    return crossings


# The H∞ gain of the nominal robot -----------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class LinearProblem:
    """The linear problem of the nominal robot: ẋ = A x + B1 d + B2 u, z = (C x, R2^½ u)."""

    a: np.ndarray
    b1: np.ndarray
    b2: np.ndarray
    c: np.ndarray
    r2: np.ndarray

    @staticmethod
    def of(
        family: LinearFamily,
        rows: np.ndarray,
        command: bool,
        torques: np.ndarray | None = None,
        r2: np.ndarray | None = None,
    ) -> LinearProblem:
        """Problem with h(x) = C x, `rows` (s, n) = C, and R2 (m, m), by default I; disturbances are the command, by
        ė = q − d, and `torques` (2 joints, k) at links and motors."""
        a, b2, joints = family.a[0], family.b[0], len(family.robot.joint_names)
        parts = [0.0 - np.eye(len(a), joints, joints - len(a))] if command else []
        parts += [] if torques is None else [family.torques @ torques]
        return LinearProblem(a, np.hstack(parts), b2, rows, np.eye(b2.shape[1]) if r2 is None else r2)

    def linear_part(self) -> LinearPart:
        """The problem in the form of the synthesis, its input scaled so that R2 = I."""
        priced = np.linalg.solve(np.linalg.cholesky(self.r2), self.b2.T).T
        return LinearPart(self.a, self.b1, priced, self.c, tuple(f"x{k + 1}" for k in range(len(self.a))))

    @cached_property
    def gamma_star(self) -> float:
        """Smallest feasible level, to `ROUGH`."""
        return linear_smallest_gamma(self.linear_part(), ROUGH)

    def design(self, gamma: float) -> HJISolution:
        """The gain −R2⁻¹ B2ᵀ P at a level."""
        g1, g2 = ({0: b[:, :, None]} for b in (self.b1, self.b2))
        return linear_law(
            PolynomialPlant.from_parts(len(self.a), {1: self.a}, g1, g2, {1: self.c}, self.r2), gamma
        )

    def attained(self, gain: np.ndarray) -> float:
        """The level that a stabilising gain attains: the H∞ norm from d to z of its loop, to `ROUGH`."""
        a, nothing = self.a + self.b2 @ gain, np.zeros((len(self.a), 1))
        c = np.vstack([self.c, np.linalg.cholesky(self.r2).T @ gain])
        return linear_smallest_gamma(replace(self.linear_part(), a=a, b2=nothing, c=c), ROUGH)


# The H∞ gain of all robots within the tolerances -----------------------------------------------------------
@dataclass(frozen=True, eq=False)
class UncertaintyChannel:
    """A rank-one part of the effect of a tolerance; its signal comes from either the state or the input."""

    #: The parameter without its joint, and "state" or "input".
    group: tuple[str, str]
    torque: np.ndarray  # (2 joints,), t at links and motors
    by_state: np.ndarray  # (n,), c on the plant's states
    by_input: np.ndarray  # (m,), e

    def padded(self, states: int) -> np.ndarray:
        """c on all states, (states,): zeros for the integrals."""
        return np.pad(self.by_state, (0, states - len(self.by_state)))


#: Largest level that is tried, relative to that of the nominal problem.
LARGEST_LEVEL = 1e4

#: Accuracy of a fraction of the tolerances, and the smallest fraction that counts.
FRACTION_WIDTH, MIN_FRACTION = 0.02, 0.02

#: Number of balances after the first.
BALANCES = 6


@dataclass(frozen=True, eq=False)
class RobustProblem:
    """A nominal problem with the scaled channels of the tolerances, or of a fraction of them."""

    nominal: LinearProblem
    torques: np.ndarray  # (n, 2 joints), where torques at links and motors enter
    channels: tuple[UncertaintyChannel, ...]
    log: np.ndarray  # log s of each channel
    fraction: float = 1.0  # of the tolerances, that the channels stand for

    @cached_property
    def parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(L, F, E): torques L w (2 joints, k), rows F x (l, n) and price uᵀ E u of all channels together.

        L Lᵀ = Σ t tᵀ/s², FᵀF = Σ s² c cᵀ, E = Σ s² e eᵀ, each times the fraction.
        """
        n, m, two = len(self.nominal.a), self.nominal.b2.shape[1], self.torques.shape[1]
        enter, seen, price = np.zeros((two, two)), np.zeros((n, n)), np.zeros((m, m))
        for channel, log in zip(self.channels, self.log):
            s2 = float(np.exp(2.0 * log))
            padded = channel.padded(n)
            enter += self.fraction * np.outer(channel.torque, channel.torque) / s2
            seen += self.fraction * s2 * np.outer(padded, padded)
            price += self.fraction * s2 * np.outer(channel.by_input, channel.by_input)
        return _root(enter), _root(seen).T, price

    def scaled(self, gamma: float) -> LinearProblem:
        """The problem of one level γ, its Δ-channels entering with γ L."""
        (enter, seen, price), g = self.parts, self.nominal
        b1 = np.hstack([g.b1, gamma * self.torques @ enter])
        return LinearProblem(g.a, b1, g.b2, np.vstack([g.c, seen]), g.r2 + price)

    def feasible(self, gamma: float) -> bool:
        """Whether the problem of this level has a solution."""
        return is_feasible(self.scaled(gamma).linear_part(), gamma)

    @cached_property
    def gamma_star(self) -> float:
        """`smallest_gamma` to `ROUGH`."""
        return self.smallest_gamma(ROUGH)

    def smallest_gamma(self, relative: float) -> float:
        """Smallest γ for every robot within the fraction of the tolerances, to a relative width.

        Raises `NoFeasibleGamma` if there is none.
        """
        low = self.nominal.gamma_star
        high = LARGEST_LEVEL * low
        if not self.feasible(high):
            raise NoFeasibleGamma(
                "No attenuation level holds for the whole tolerances.",
                f"no solution even at gamma = {high:.3g}, with {100 * self.fraction:.3g} % of the tolerances",
                "tighter tolerances in the robot's file, or the preset damped",
            )
        return bisected(self.feasible, high, low, relative)[0]

    @property
    def order(self) -> tuple[float, float]:
        """Sort key: the largest fraction of the tolerances first; for all of them, the smallest level."""
        return -self.fraction, self.gamma_star if self.fraction == 1.0 else 0.0

    def design(self, gamma: float) -> HJISolution:
        """The gain at a level."""
        return self.scaled(gamma).design(gamma)

    def with_largest_fraction(self) -> RobustProblem:
        """The problem with the largest fraction of the tolerances for which some level has a solution, to
        `FRACTION_WIDTH`."""
        level = LARGEST_LEVEL * self.nominal.gamma_star

        def feasible(fraction: float) -> bool:
            return replace(self, fraction=fraction).feasible(level)

        fraction = 1.0 if feasible(1.0) else bisected(feasible, 0.0, 1.0, FRACTION_WIDTH, relative=False)[0]
        return replace(self, fraction=fraction)


def _root(matrix: np.ndarray) -> np.ndarray:
    """X (n, k) of full rank with X Xᵀ = matrix."""
    values, vectors = np.linalg.eigh(matrix)
    kept = values > 1e-12 * max(values[-1], 1e-300)
    return vectors[:, kept] * np.sqrt(values[kept])


def find_scalings(
    nominal: LinearProblem, torques: np.ndarray, channels: tuple[UncertaintyChannel, ...], ratio: float
) -> RobustProblem:
    """The problem with the scalings of its channels; the head of this file describes the search.

    `ratio`: γ/γ* of the designs in whose loops channels are balanced. Raises `NoFeasibleGamma` if no solution exists
    even for the fraction `MIN_FRACTION` of the tolerances.
    """
    first = RobustProblem(nominal, torques, channels, np.zeros(len(channels)))
    best = _balanced(first, nominal.design(ratio * nominal.gamma_star))
    for _ in range(BALANCES):
        if best.fraction < MIN_FRACTION:
            break
        within = replace(best, fraction=0.9 * best.fraction) if best.fraction < 1.0 else best
        again = _balanced(first, within.design(ratio * within.gamma_star))
        if again.order >= best.order:
            break
        best = again
    if best.fraction < MIN_FRACTION:
        raise NoFeasibleGamma(
            "No attenuation level holds for these tolerances, nor for a part of them.",
            f"no solution even with {100 * MIN_FRACTION:g} % of the tolerances",
            "the preset damped, or another bandwidth or damping",
        )
    return best if best.fraction == 1.0 else replace(best, fraction=0.9 * best.fraction)


def _balanced(problem: RobustProblem, design: HJISolution) -> RobustProblem:
    """The problem with s⁴ = gᵀPXPg / zXzᵀ of each channel, where X is the covariance of the loop under disturbances of
    equal cost, and with the largest fraction of the tolerances for these s."""
    from scipy.linalg import solve_continuous_lyapunov

    gain, p = design.gain, design.P
    loop = problem.nominal.a + problem.nominal.b2 @ gain
    x = cast("np.ndarray", solve_continuous_lyapunov(loop, -np.diag(1.0 / np.abs(np.diag(p)))))
    log = np.zeros(len(problem.channels))
    for k, channel in enumerate(problem.channels):
        g = p @ (problem.torques @ channel.torque)
        z = channel.by_input @ gain + channel.padded(len(loop))
        log[k] = 0.25 * np.log((g @ x @ g) / (z @ x @ z))
    return replace(problem, log=log).with_largest_fraction()


# Weights for a behaviour --------------------------------------------------------------------------------
#: The damping weight ζ: its first value beyond 0, its growth, and the largest that is tried.
SMALLEST, GROWTH, LARGEST = 0.02, 1.7, 30.0

#: Relative accuracy of the bandwidth; largest number of iterations of the inner search, and of the bisection.
FITS, TURNS, HALVINGS = 0.01, 30, 6

#: Rounds in which the ζ of single joints are lowered; the largest factor of one reduction; the ratio of required to
#: present damping below which a reduction is tried; and the powers of this ratio that are tried.
ROUNDS, MOST_LOWERED, WORTH, POWERS = 2, 2.0, 0.9, (0.95, 0.5)

#: Factors on the ζ of a search for another bandwidth or damping, tried in turn.
PROPORTIONS = (1.0, 1.1, 1.25, 1.5, 2.0)

#: A target frequency is multiplied by this power of required over present bandwidth (with 1, coupled joints would not
#: converge); and the largest target frequency, over the lowest vibration with locked motors.
CAUTION, FASTEST = 0.6, 30.0


class DampingOutOfReach(InvalidInput):
    """No weights damp every oscillation as required; `reached` is a damping ratio a little below the best."""

    reached = 0.0


#: Bandwidth by default, and advised where a larger one cannot be had, relative to the lowest vibration of the links
#: with locked motors.
BANDWIDTH_FRACTION = 0.3


def required_bandwidth(stated: Any, scales: JointScales, joints: int) -> np.ndarray:
    """Bandwidth (n,), rad/s: as stated, or `BANDWIDTH_FRACTION` of the lowest vibration with locked motors."""
    wanted = BANDWIDTH_FRACTION * scales.antiresonance if stated is None else stated
    bandwidth = np.atleast_1d(np.asarray(wanted, dtype=float))
    refuse_if(
        len(bandwidth) not in (1, joints),
        "The bandwidths do not fit the joints.",
        f"expected one number or {joints}, got {bandwidth.tolist()}",
        "one bandwidth for all joints",
    )
    return np.broadcast_to(bandwidth, (joints,)).copy()


def vibration_text(lowest: float) -> str:
    """The slowest vibration of an arm at a pose, rad/s, and the bandwidth that goes with it."""
    return (
        f"with held motors the nominal arm vibrates at {lowest:.3g} rad/s or faster at this pose, and "
        f"{BANDWIDTH_FRACTION:g} of that is the usual bandwidth"
    )


@dataclass(frozen=True, eq=False)
class TargetBehaviour:
    """The bandwidth and the damping for which weights are searched."""

    bandwidth: np.ndarray  # (n,), of each joint at least, rad/s
    damping: float  # of every oscillation at least

    def where_not(self, usable: np.ndarray, bandwidth: np.ndarray) -> np.ndarray:
        """`bandwidth` (n,) where it is `usable` (n,), elsewhere this one, rad/s."""
        return np.where(usable, bandwidth, self.bandwidth)

    @property
    def bandwidth_text(self) -> str:
        """The bandwidth, or the range of several, with its unit."""
        return f"{_text(self.bandwidth)} rad/s"

    @property
    def text(self) -> str:
        """Bandwidth and damping ratio."""
        return f"{self.bandwidth_text} and a damping ratio of {self.damping:.3g}"


@dataclass(frozen=True, eq=False)
class WeightCandidate:
    """Weights that were tried, and the behaviour with them."""

    target_frequency: np.ndarray  # (n,), ω of each joint, rad/s
    damping_weights: np.ndarray  # (n,), ζ of each joint
    design: HJISolution
    gamma_star: float  # the smallest feasible level of these weights, to `ROUGH`
    behaviour: Behaviour

    @property
    def weights(self) -> tuple[np.ndarray, np.ndarray]:
        """ω and ζ (n,) of each joint."""
        return self.target_frequency, self.damping_weights

    @property
    def damping_weight(self) -> float:
        """The largest ζ."""
        return float(self.damping_weights.max())


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The chosen weights, and all that were tried: one candidate per ζ, in the order of the search."""

    chosen: WeightCandidate
    candidates: tuple[WeightCandidate, ...]


def search(
    target: TargetBehaviour,
    family: LinearFamily,
    synthesis: Callable[[np.ndarray, np.ndarray], tuple[HJISolution, float]],
    antiresonance: float,
    each: bool = True,
    near: WeightCandidate | None = None,
) -> SearchResult:
    """Search the weights with which the linear loop has the required bandwidth and damping.

    `synthesis` solves the problem for ω (n,) and ζ (n,), and returns solution and γ*. `antiresonance` is the lowest
    frequency with locked motors, rad/s. With `each`, the ζ of single joints are lowered at the end. With `near`,
    weights for another bandwidth or damping, the search begins at their ω and ζ in proportion, which is faster. Raises
    `InvalidInput`, with the active limit and the best result, if the requirement cannot be met.
    """
    start, proportional = 1.5 * target.bandwidth, ()
    if near is not None:
        start = near.target_frequency * target.bandwidth / near.behaviour.bandwidth
        weights = near.damping_weights * target.damping / near.behaviour.damping
        proportional = (more * weights for more in PROPORTIONS)
    attempt = _WeightSearch(target, family, synthesis, FASTEST * antiresonance, start)
    chosen = next((candidate for tried in proportional if (candidate := attempt.fit_damped(tried))), None)
    chosen = chosen or attempt.damped()
    if each and len(target.bandwidth) > 1 and chosen.damping_weight:
        chosen = attempt.lowered(chosen)
    return SearchResult(chosen, tuple(attempt.tried))


@dataclass
class _WeightSearch:
    target: TargetBehaviour
    family: LinearFamily
    synthesis: Callable[[np.ndarray, np.ndarray], tuple[HJISolution, float]]
    fastest: float  # target frequency that is tried, rad/s
    start: np.ndarray  # (n,), target frequencies
    tried: list[WeightCandidate] = field(default_factory=list[WeightCandidate])
    reached: float = 0.0  # largest fraction of the bandwidths that a stable loop had in all joints at once

    def fit(self, damping_weight: float | np.ndarray) -> WeightCandidate | None:
        """The inner search: the candidate of a ζ, or None if no target frequencies give the bandwidth."""
        bandwidth = self.target.bandwidth
        weights = np.broadcast_to(np.asarray(damping_weight, dtype=float), len(bandwidth))
        frequency = self.tried[-1].target_frequency if self.tried else np.minimum(self.start, self.fastest)
        for _ in range(TURNS):
            try:
                design, star = self.synthesis(frequency, weights)
            except FlexhinfError:
                break
            behaviour = behaviour_of(self.family, design.gain)
            if behaviour.damping == -np.inf:
                break
            self.reached = max(self.reached, float((behaviour.bandwidth / bandwidth).min()))
            ratio = bandwidth / np.maximum(behaviour.bandwidth, 1e-3 * bandwidth)
            if np.all(np.abs(ratio - 1.0) <= FITS):
                self.tried.append(WeightCandidate(frequency, weights, design, star, behaviour))
                return self.tried[-1]
            frequency = frequency * np.clip(ratio, 0.4, 2.5) ** CAUTION
            if np.any(frequency > self.fastest):
                break
        return None

    def fit_damped(self, damping_weight: float | np.ndarray) -> WeightCandidate | None:
        candidate = self.fit(damping_weight)
        return candidate if candidate and candidate.behaviour.damping >= self.target.damping else None

    def damped(self) -> WeightCandidate:
        """The smallest ζ with which every oscillation is damped as required, by growth and bisection."""
        damping_weight, below = 0.0, 0.0
        best: WeightCandidate | None = None
        while damping_weight <= LARGEST:
            tried = self.fit(damping_weight)
            if tried is not None:
                best = tried if best is None or tried.behaviour.damping > best.behaviour.damping else best
                if tried.behaviour.damping >= self.target.damping:
                    break
                below = damping_weight
            damping_weight = max(SMALLEST, damping_weight * GROWTH)
        else:
            expected = f"expected a bandwidth of {self.target.text}"
            if best is None:
                lowest, reached = self.fastest / FASTEST, self.reached * self.target.bandwidth
                found = f"the best found that is stable within the tolerances is {_text(reached)} rad/s"
                slower = min(BANDWIDTH_FRACTION * lowest, 0.5 * float(self.target.bandwidth.min()))
                raise InvalidInput(
                    f"No controller was found that reaches {self.target.bandwidth_text} at this pose of the arm.",
                    f"{expected}; {found if self.reached else 'no loop was stable within the tolerances'}",
                    f"bandwidth={slower:.2g}, which is not tested yet: {vibration_text(lowest)}",
                )
            best_damping = best.behaviour.damping
            refused = DampingOutOfReach(
                "The specification cannot be met: the damping of the oscillations binds.",
                f"{expected} for the robot and its tolerances; the best found at this bandwidth is {best_damping:.3g} "
                f"({best.behaviour.nominal_damping:.3g} for the nominal robot)",
                f"damping={max(0.0, 0.95 * best_damping):.2g}, or another `bandwidth`",
            )
            refused.reached = max(0.0, 0.95 * best_damping)
            raise refused
        width = 2.0**-HALVINGS * (tried.damping_weight - below)
        _, candidate = bisected(self.fit_damped, tried.damping_weight, below, width, relative=False)
        return candidate or tried

    def lowered(self, best: WeightCandidate) -> WeightCandidate:
        """Lower the ζ of each joint to the value that its vibration needs, in turn, the most damped joint first.

        Every oscillation keeps the required damping, so a ζ that other joints need is kept.
        """
        required = self.target.damping
        for _ in range(ROUNDS):
            before = best
            for joint in np.argsort(-best.behaviour.joint_damping):
                ratio = required / min(best.behaviour.joint_damping[joint], MOST_LOWERED * required)
                for power in POWERS if ratio < WORTH else ():
                    weights = best.damping_weights.copy()
                    weights[joint] *= ratio**power
                    if tried := self.fit_damped(weights):
                        best = tried
                        break
            if best is before:
                break
        return best


def _text(values: np.ndarray) -> str:
    low, high = values.min(), values.max()
    return f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
