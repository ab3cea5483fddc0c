"""The preset `robust`: a gain that holds for every robot within its tolerances, with constant scalings.

Channel i of the tolerances enters with g_i/s_i and is seen through s_i z_i. If

    V_x f + ½ |h|² + ½ Σ s_i² |z_i|² + ½ V_x (g1 g1ᵀ/γ² + Σ g_i g_iᵀ/s_i² − g2 R2⁻¹ g2ᵀ) V_xᵀ = 0

has a solution, then V̇ ≤ ½ γ²|d|² − ½|z|² for every |Δ_i| ≤ 1, as w_i = Δ_i z_i costs no more than it is seen
[shen1995]. The Δ-channels do not scale with γ: in a problem of one level γ they enter with γ g_i/s_i. The s_i are found
on the linear part, one for each channel: what enters is balanced with what is seen, first in the nominal loop, then a
few times in the loop that came of it; a simplex search over one factor for each quantity (all stiffnesses share one)
ends it. Where no γ does for the whole tolerances, the largest fraction of them is searched for and reported.

Tolerances as disturbances: each uncertain parameter becomes a channel (Shen & Tamura 1995).

A parameter p in p0 ± δ changes the accelerations; seen as torques at links and motors the change is, on the linear
part,

    w = Δ (T_x x + T_u u),   |Δ| ≤ 1,

with T taken between the ends of the interval, the robot at its own equilibrium at each of them. Split into rank-one
parts, each is a torque t w' driven by a signal z_Δ = c x or z_Δ = e u that is seen through the unknown Δ: for the
stiffness t = δ^½ (−1, 1), z_Δ = δ^½ (q1 − q2). Where the change bends, as with 1/R, a part is as long as towards the
end where more changes, so that |Δ| ≤ 1 holds at both. Constant terms, such as the weight of a payload, are left
to the integral.

A channel covers its tolerance alone. At a corner of the tolerances products of them act, such as m·g·l and k_t/R, and a
robot there changes by a little more than the sum of its channels. So the linear part of the dissipation inequality is
checked at the corners themselves, and the tolerances of the channels are enlarged step by step until it holds there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from flexhinf.analysis import LinearCorners
from flexhinf.design.problem.weights import ROUGH, LinearDesign, LinearProblem
from flexhinf.errors import FlexhinfError, InvalidInput, NoFeasibleGamma, NumericalFailure
from flexhinf.hinf.linear_part import is_feasible
from flexhinf.plant import GeneralisedPlant, Penalty, Plant
from flexhinf.robot import Robot

#: Rank-one parts smaller than this fraction of a parameter's largest are left out.
SMALL = 1e-3

#: A change smaller than this, relative to the robot's own torques, is rounding.
ROUNDING = 1e-10

#: Factors by which the tolerances are enlarged, one after the other, until the inequality holds at the corners.
ENLARGED = (1.0, 1.05, 1.1, 1.15, 1.2, 1.3)

Design = TypeVar("Design")


@dataclass(frozen=True, eq=False)
class Channel:
    """A rank-one part of what a tolerance does; it is driven either by the state or by the input."""

    quantity: str  # the parameter without its joint; channels of one quantity and kind share a scaling
    torque: np.ndarray  # (2 joints,), t at links and motors
    by_state: np.ndarray  # (n,), c on the plant's states
    by_input: np.ndarray  # (m,), e

    @property
    def group(self) -> tuple[str, str]:
        """Quantity, and what drives it."""
        return self.quantity, "input" if np.any(self.by_input) else "state"

    def padded(self, n: int) -> np.ndarray:
        """c (n,) with zeros for the integrals."""
        return np.pad(self.by_state, (0, n - len(self.by_state)))


def _linearised(robot: Robot, plant: Any, signs: dict[str, float], pose: np.ndarray) -> np.ndarray:
    """[A B] (n, n + m) at a corner of the tolerances, the robot at its own equilibrium at a pose."""
    known = plant.parameters.known(robot.corner(signs))
    equilibrium = robot.operating_point(pose, parameters=known)
    return np.hstack(plant.with_parameters(**known).linearise(*equilibrium)[:2])


def channels(robot: Robot, poses: Sequence[np.ndarray]) -> tuple[Channel, ...]:
    """Channels of all uncertain parameters, each at the pose where it changes the robot most."""
    plant = robot.plant()
    channel_list: list[Channel] = []
    linear = [(pose, plant.linearise(*robot.operating_point(pose))) for pose in poses]
    no_state, no_input = np.zeros(plant.n), np.zeros(len(plant.inputs))
    for parameter in robot.uncertain:
        name, changes = parameter.name, []
        for pose, (a, b, torques, _) in linear:
            # [T_x T_u] from the nominal robot to each end of the interval, each at its own equilibrium.
            nominal = np.hstack([a, b])
            least = ROUNDING * np.abs(np.linalg.lstsq(torques, nominal, rcond=None)[0]).max()
            differences = (_linearised(robot, plant, {name: sign}, pose) - nominal for sign in (1.0, -1.0))
            ends = np.array([np.linalg.lstsq(torques, each, rcond=None)[0] for each in differences])
            changes.append(np.where(np.abs(ends) > least, ends, 0.0))  # (2, 2 joints, n + m)
        largest = max(changes, key=lambda ends: float(np.abs(ends).max()))
        joint = next((joint for joint in robot.joint_names if name.endswith(f"_{joint}")), "")
        quantity = name.removesuffix(f"_{joint}") if joint else name
        # Singular parts of half the difference between the ends, each made as long as the end that it reaches less.
        for by_input, (up, down) in enumerate((largest[:, :, : plant.n], largest[:, :, plant.n :])):
            left, sizes, right = np.linalg.svd(0.5 * (up - down), full_matrices=False)
            for size, t, c in zip(sizes, left.T, right):
                if size > SMALL * sizes[0]:
                    root = np.sqrt(max(size, abs(t @ up @ c), abs(t @ down @ c)))
                    driven = (no_state, root * c) if by_input else (root * c, no_input)
                    channel_list.append(Channel(quantity, root * t, *driven))
    return tuple(channel_list)


def tolerance_channels(robot: Robot, poses: Sequence[np.ndarray]) -> tuple[Channel, ...]:
    """The `channels` of a robot. Raises `InvalidInput` if there are none."""
    if channel_list := channels(robot, poses):
        return channel_list
    raise InvalidInput(
        f"The robot {robot.name!r} states no tolerances that the preset robust could stand for.",
        "expected parameters with a tolerance that changes how the robot moves, got none",
        "tolerance = 10 beside a value in the robot's file, or preset='damped'",
    )


# Products of tolerances ---------------------------------------------------------------------------------
def acting_corners(robot: Robot, goal: np.ndarray, problem: GeneralisedPlant) -> LinearCorners:
    """The plant of a problem without channels at the corners of those tolerances that change it, each at its own
    equilibrium at the goal (n,), link positions in rad or m."""
    plant = problem.plant
    nominal = np.hstack(plant.linearise(*robot.operating_point(goal))[:2])  # traced once, for all corners
    ends = {p.name: _linearised(robot, plant, {p.name: 1.0}, goal) for p in robot.uncertain}
    names = [name for name, end in ends.items() if not np.allclose(end, nominal, rtol=1e-12, atol=0.0)]
    return LinearCorners.of(
        problem,
        lambda signs: robot.corner(dict(zip(names, signs, strict=True))),
        len(names),
        lambda values: robot.operating_point(goal, parameters=values),
    )


def enlarge_tolerances(
    first: Design, design_at: Callable[[float], Design], failing: Callable[[Design], int]
) -> Design:
    """The first design with enlarged tolerances whose inequality holds at every corner; `first` if there is none.

    `first` is of the tolerances as they are; `design_at` makes the design of a factor of them, and may raise where the
    larger tolerances are out of reach; `failing` counts the corners that break the inequality of a design.
    """
    for factor in ENLARGED[1:] if failing(first) else ():
        try:
            larger = design_at(factor)
        except FlexhinfError:  # out of reach: the page says how many corners the first design leaves
            break
        if not failing(larger):
            return larger
    return first


#: Largest level that is tried, relative to that of the nominal problem.
LARGEST = 1e4

#: Shares of the tolerances are found to this width; less than the smallest is none.
FRACTION_WIDTH, LEAST_FRACTION = 0.02, 0.02

#: Balances after the first; evaluations of the simplex search for each factor, and the most states it is made with.
BALANCES, EVALUATIONS, MOST_STATES = 6, 20, 15


@dataclass(frozen=True, eq=False)
class Scalings:
    """Scalings of the channels, and the fraction of the tolerances that the channels stand for."""

    log: np.ndarray  # log s of each channel
    fraction: float = 1.0


@dataclass(frozen=True, eq=False)
class RobustProblem:
    """A nominal problem with the channels of the tolerances; torques enter by `torques` (n, 2 joints)."""

    nominal: LinearProblem
    torques: np.ndarray
    channels: tuple[Channel, ...]

    def parts(self, scalings: Scalings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(L, F, E): torques L w (2 joints, k), rows F x (l, n) and price uᵀ E u of all channels together.

        L Lᵀ = Σ t tᵀ/s², FᵀF = Σ s² c cᵀ, E = Σ s² e eᵀ, each times the fraction.
        """
        n, m, two = len(self.nominal.a), self.nominal.b2.shape[1], self.torques.shape[1]
        enter, seen, price = np.zeros((two, two)), np.zeros((n, n)), np.zeros((m, m))
        for channel, log in zip(self.channels, scalings.log):
            s2, padded = float(np.exp(2.0 * log)), channel.padded(n)
            enter += scalings.fraction * np.outer(channel.torque, channel.torque) / s2
            seen += scalings.fraction * s2 * np.outer(padded, padded)
            price += scalings.fraction * s2 * np.outer(channel.by_input, channel.by_input)
        return _root(enter), _root(seen).T, price

    def scaled(
        self, gamma: float, scalings: Scalings, parts: tuple[np.ndarray, ...] | None = None
    ) -> LinearProblem:
        """The problem of one level γ, its Δ-channels entering with γ L; `parts` where they are known."""
        (enter, seen, price), g = parts or self.parts(scalings), self.nominal
        b1 = np.hstack([g.b1, gamma * self.torques @ enter])
        return LinearProblem(g.a, b1, g.b2, np.vstack([g.c, seen]), g.r2 + price)

    def feasible(self, gamma: float, scalings: Scalings, parts: tuple[np.ndarray, ...] | None = None) -> bool:
        """Whether the problem of this level has a solution."""
        return is_feasible(self.scaled(gamma, scalings, parts).linear_part(), gamma)

    def gamma_star(self, scalings: Scalings, relative: float = ROUGH) -> float:
        """Smallest γ for every robot within the fraction of the tolerances.

        Raises `NoFeasibleGamma` if there is none.
        """
        low, parts = self.nominal.gamma_star(), self.parts(scalings)
        high = LARGEST * low
        if not self.feasible(high, scalings, parts):
            raise NoFeasibleGamma(
                "No attenuation level holds for the whole tolerances.",
                f"no solution even at gamma = {high:.3g}, with {100 * scalings.fraction:.3g} % of the tolerances",
                "tighter tolerances in the robot's file, or the preset damped",
            )
        while high > (1.0 + relative) * low:
            middle = float(np.sqrt(low * high))
            low, high = (low, middle) if self.feasible(middle, scalings, parts) else (middle, high)
        return high

    def design(self, ratio: float, scalings: Scalings) -> LinearDesign:
        """The gain at `ratio` times the smallest level."""
        star = self.gamma_star(scalings)
        return self.scaled(ratio * star, scalings).design(ratio * star, star)

    def fraction(self, scalings: Scalings) -> float:
        """The largest fraction of the tolerances for which some level has a solution, within `FRACTION_WIDTH`."""
        level, low, high = LARGEST * self.nominal.gamma_star(), 0.0, 1.0
        if self.feasible(level, replace(scalings, fraction=high)):
            return high
        while high - low > FRACTION_WIDTH:
            middle = 0.5 * (low + high)
            fits = self.feasible(level, replace(scalings, fraction=middle))
            low, high = (middle, high) if fits else (low, middle)
        return low


def _root(matrix: np.ndarray) -> np.ndarray:
    """X (n, k) of full rank with X Xᵀ = matrix."""
    values, vectors = np.linalg.eigh(matrix)
    kept = values > 1e-12 * max(values[-1], 1e-300)
    return vectors[:, kept] * np.sqrt(values[kept])


def find_scalings(problem: RobustProblem, ratio: float) -> Scalings:
    """Scalings for a problem, found as the head of this file says.

    `ratio`: γ/γ* of the designs in whose loops channels are balanced. Raises `NoFeasibleGamma` if not even
    `LEAST_FRACTION` of the tolerances can be covered.
    """
    from scipy.optimize import minimize

    def better(scalings: Scalings, other: Scalings) -> bool:
        if scalings.fraction < 1.0 or other.fraction < 1.0:
            return scalings.fraction > other.fraction
        return problem.gamma_star(scalings) < problem.gamma_star(other)

    best = _balanced(problem, problem.nominal.design_at(ratio))
    for _ in range(BALANCES):
        if best.fraction < LEAST_FRACTION:
            break
        within = replace(best, fraction=best.fraction * (0.9 if best.fraction < 1.0 else 1.0))
        again = _balanced(problem, problem.design(ratio, within))
        if not better(again, best):
            break
        best = again
    if len(problem.nominal.a) <= MOST_STATES:  # a simplex search over one factor for each quantity
        start, groups = best, list(dict.fromkeys(channel.group for channel in problem.channels))
        places = np.array([groups.index(channel.group) for channel in problem.channels])

        def moved(factors: np.ndarray) -> Scalings:
            return replace(start, log=start.log + factors[places])

        def cost(factors: np.ndarray) -> float:
            if start.fraction < 1.0:
                return -problem.fraction(moved(factors))
            try:
                return float(np.log(problem.gamma_star(moved(factors))))
            except (NoFeasibleGamma, NumericalFailure):
                return np.inf

        options = {"maxfev": EVALUATIONS * (1 + len(groups)), "xatol": 0.02, "fatol": 1e-3}
        end = moved(minimize(cost, np.zeros(len(groups)), method="Nelder-Mead", options=options).x)
        end = replace(end, fraction=problem.fraction(end))
        best = end if better(end, start) else start
    if best.fraction < LEAST_FRACTION:
        raise NoFeasibleGamma(
            "No attenuation level holds for these tolerances, nor for a part of them.",
            f"no solution even with {100 * LEAST_FRACTION:g} % of the tolerances",
            "the preset damped, or another bandwidth or damping",
        )
    return best if best.fraction == 1.0 else replace(best, fraction=0.9 * best.fraction)


def _balanced(problem: RobustProblem, design: LinearDesign) -> Scalings:
    """s⁴ = gᵀPXPg / zXzᵀ of each channel, X the motions of the loop under disturbances of equal cost; and the fraction
    of the tolerances that is covered so."""
    from scipy.linalg import solve_continuous_lyapunov

    loop, p = problem.nominal.a + problem.nominal.b2 @ design.gain, design.p
    x = solve_continuous_lyapunov(loop, -np.diag(1.0 / np.abs(np.diag(p))))
    log = np.zeros(len(problem.channels))
    for k, channel in enumerate(problem.channels):
        g = p @ (problem.torques @ channel.torque)
        z = channel.by_input @ design.gain + channel.padded(len(loop))
        log[k] = 0.25 * np.log((g @ x @ g) / (z @ x @ z))
    return Scalings(log, problem.fraction(Scalings(log)))


#: Names of the disturbances that stand for tolerances, numbered from 1.
PREFIX = "tolerance"


@dataclass(frozen=True)
class UncertainFlow:
    """The robot's ẋ with torques L w at links and motors, beside its own disturbances; L is a parameter."""

    flow: Any
    torques: int  # number of the robot's own disturbances: torques at links and motors

    def __call__(self, x: Any, u: Any, d: Any, p: Any) -> Any:
        """The rates of all states, of any element."""
        own, tolerances = d[: self.torques], d[self.torques :]
        return self.flow(x, u, own + np.asarray(p.tolerance_channels) @ tolerances, p)


def with_channels(plant: Plant, enter: np.ndarray) -> Plant:
    """The robot's plant with disturbances w that enter as torques L w; `enter` (2 joints, k) is L."""
    names = tuple(f"{PREFIX}_{k + 1}" for k in range(enter.shape[1]))
    return Plant(
        UncertainFlow(plant.flow, len(plant.disturbances)),
        plant.output,
        states=plant.states,
        inputs=plant.inputs,
        disturbances=(*plant.disturbances, *names),
        parameters={**plant.parameters.values, "tolerance_channels": enter},
        outputs=plant.outputs,
        units=plant.units,
        groups=plant.groups,
        limits=plant.limits,
    )


def sized_channels(problem: GeneralisedPlant, nominal: GeneralisedPlant, size: float) -> GeneralisedPlant:
    """A problem whose channels stand for a fraction `size` of the tolerances, as `RobustProblem.parts` has it.

    `problem` has the channels of the whole tolerances, `nominal` none.
    """
    if size <= 0.0 or size >= 1.0:
        return nominal if size <= 0.0 else problem
    known = problem.plant.parameters.values["tolerance_channels"]
    plant = problem.plant.with_parameters(tolerance_channels=np.sqrt(size) * np.asarray(known))
    without, whole = (np.array(p.expand(1).h_parts[1], dtype=float) for p in (nominal, problem))
    rows = np.vstack([np.sqrt(1.0 - size) * without, np.sqrt(size) * whole])  # hᵀh is linear in the size
    return replace(problem, plant=plant, penalty=Penalty(rows, (1.0 - size) * nominal.r2 + size * problem.r2))
