"""The linear part of a design at its goal: the nominal robot and its H∞ gain, and robots within the tolerances.

A search asks for many gains. What does not change with the gain is computed once here: ẋ = A x + B u + G d of every
member, the integrals of the tracking errors appended, deviations from each member's own equilibrium.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg

from flexhinf.design.modes import Mode, modes_of, named_modes, stiffness_and_inertia
from flexhinf.hinf import linear_law
from flexhinf.hinf.linear_part import LinearPart, linear_smallest_gamma
from flexhinf.plant import PolynomialPlant
from flexhinf.robot import Robot

#: Corners of the tolerances that a search looks at, beside the nominal robot.
MEMBERS = 32

#: Corners among which the worst for the first weights are looked for, to be members of the second search.
MANY = 400

#: Relative width at which the bisection for γ* ends during a search.
ROUGH = 1e-3


@dataclass(frozen=True, eq=False)
class LinearFamily:
    """Linearisations of N members, the nominal one first.

    Attributes
    ----------
    a, b : (N, n, n), (N, n, m)
        With one integral per joint as last states.
    torques : (n, 2 joints)
        Where torques at links and motors enter, nominal.
    energy : (stiffness, inertia)
        Of the nominal robot, to tell vibrations from other modes.
    period : float
        s, of the samples at which the law of the nominal robot acts; 0: always.
    """

    a: np.ndarray
    b: np.ndarray
    torques: np.ndarray
    joints: tuple[str, ...]
    energy: tuple[np.ndarray, np.ndarray]
    period: float = 0.0

    @cached_property
    def sampled(self) -> tuple[np.ndarray, np.ndarray]:
        """(Φ, Γ) of the nominal robot over one period with a constant input."""
        n, m = self.nominal[1].shape
        both = np.zeros((n + m, n + m))
        both[:n] = np.hstack(self.nominal)
        held = scipy.linalg.expm(both * self.period)
        return held[:n, :n], held[:n, n:]

    @property
    def nominal(self) -> tuple[np.ndarray, np.ndarray]:
        """(A, B) of the nominal robot."""
        return self.a[0], self.b[0]

    def with_members(self, other: LinearFamily, places: Any) -> LinearFamily:
        """The same family with some members of another one."""
        chosen = sorted(set(places))
        a, b = np.concatenate([self.a, other.a[chosen]]), np.concatenate([self.b, other.b[chosen]])
        return replace(self, a=a, b=b)

    @staticmethod
    def of(
        robot: Robot, goal: np.ndarray, members: int = MEMBERS, seed: int = 0, period: float = 0.0
    ) -> LinearFamily:
        """Of a robot, corners sampled with a fixed seed.

        Parameters
        ----------
        goal : (n,)
            Link positions, rad or m.
        members : int
            Corners; none for a robot without tolerances.
        seed : int
            Of the corners.
        period : float
            s, see the class.
        """
        plant, equilibrium = robot.plant(), robot.operating_point(goal)
        plant.traced_jacobians  # noqa: B018  traced once, shared by all members
        joints, n = len(robot.joint_names), plant.n
        corners = [plant.parameters.known(values) for values in _corners(robot, members, seed)]
        matrices = [plant.linearise(*equilibrium)]
        for values in corners:
            changed = plant.with_parameters(**values)
            matrices.append(changed.linearise(*robot.operating_point(goal, parameters=values)))
        a = np.zeros((len(matrices), n + joints, n + joints))
        b = np.zeros((len(matrices), n + joints, len(plant.inputs)))
        for k, (state, inputs, _, _) in enumerate(matrices):
            a[k, :n, :n], b[k, :n] = state, inputs
        a[:, n:, :joints] = np.eye(joints)
        torques = np.zeros((n + joints, 2 * joints))
        torques[:n] = matrices[0][2]
        return LinearFamily(
            a, b, torques, robot.joint_names, stiffness_and_inertia(plant, equilibrium), period
        )


@dataclass(frozen=True, eq=False)
class Families:
    """Linearisations of one robot about one goal, made when they are first asked for, for any number of searches.

    Parameters
    ----------
    goal : (n,)
        Link positions, rad or m.
    period : float
        s, at which the law of the nominal robot acts.
    """

    robot: Any
    goal: np.ndarray
    period: float

    @cached_property
    def few(self) -> LinearFamily:
        """Those that a search begins with."""
        return LinearFamily.of(self.robot, self.goal, period=self.period)

    @cached_property
    def many(self) -> LinearFamily:
        """Those among which the worst for the first weights are looked for."""
        return LinearFamily.of(self.robot, self.goal, MANY, seed=1)


def _corners(robot: Robot, count: int, seed: int = 0) -> list[dict[str, Any]]:
    """All corners where there are no more than `count`; otherwise so many at random, whatever the parameters' order."""
    names = sorted(parameter.name for parameter in robot.uncertain)
    if not names or not count:
        return []
    if 2 ** len(names) <= count:
        signs = 1.0 - 2.0 * ((np.arange(2 ** len(names))[:, None] >> np.arange(len(names))) & 1)
    else:
        signs = np.random.default_rng(seed).choice([-1.0, 1.0], (count, len(names)))
    return [robot.corner(dict(zip(names, row.tolist()))) for row in signs]


#: Frequencies looked at, over the fastest and slowest mode of the loop, per decade.
PER_DECADE = 60


@dataclass(frozen=True, eq=False)
class Behaviour:
    """The worst over the members of a family.

    Attributes
    ----------
    bandwidth : (n,)
        Of each joint, rad/s: the smallest.
    damping : float
        Smallest damping ratio of an oscillation; infinite where nothing oscillates, −∞ for a loop that is unstable.
    nominal_damping : float
        Of the nominal robot.
    joint_damping : (n,)
        Smallest of the vibrations that are mainly in the spring of each joint; infinite where there is none.
    """

    bandwidth: np.ndarray
    damping: float
    nominal_damping: float
    joint_damping: np.ndarray


def behaviour_of(family: LinearFamily, gain: np.ndarray) -> Behaviour:
    """Of u = u* + K x, K (m, n)."""
    loops = family.a + family.b @ gain
    modes = [_modes(family, loop) for loop in loops]
    if family.period:
        modes[0] = _sampled_modes(family, gain)
    damping = [_damping(each) for each in modes]
    stable = min(damping) > -np.inf
    joints = len(family.joints)
    bandwidths = _bandwidths(loops, joints).min(axis=0) if stable else np.zeros(joints)
    vibrations = [mode for each in modes for mode in each if mode.vibration]
    own = [min((m.damping for m in vibrations if m.joint == name), default=np.inf) for name in family.joints]
    return Behaviour(bandwidths, min(damping), damping[0], np.array(own))


def worst_members(family: LinearFamily, gain: np.ndarray) -> list[int]:
    """The members with the smallest bandwidth of each joint, and with the smallest damping."""
    loops = family.a + family.b @ gain
    damping = [_damping(_modes(family, loop)) for loop in loops]
    worst = [int(np.argmin(damping))]
    if min(damping) > -np.inf:
        worst += [int(k) for k in np.argmin(_bandwidths(loops, len(family.joints)), axis=0)]
    return worst


def _modes(family: LinearFamily, loop: np.ndarray) -> tuple[Mode, ...]:
    return modes_of(loop, family.joints, *family.energy)


def _sampled_modes(family: LinearFamily, gain: np.ndarray) -> tuple[Mode, ...]:
    """Of the nominal robot, the law acting at samples; those gone within two samples do not oscillate."""
    phi, held = family.sampled
    values, vectors = np.linalg.eig(phi + held @ gain)
    rates = np.log(np.where(np.abs(values) > 1e-12, values, 1e-12).astype(complex)) / family.period
    lasting = rates.real > -0.5 / family.period
    return named_modes(rates[lasting], vectors[:, lasting], family.joints, *family.energy)


def _damping(modes: Sequence[Mode]) -> float:
    if not all(mode.stable for mode in modes):
        return -np.inf
    return min((mode.damping for mode in modes if mode.eigenvalue.imag > 0.0), default=np.inf)


def _bandwidths(loops: np.ndarray, joints: int) -> np.ndarray:
    """Of each member and joint, (N, joints): where |q_j / command_j| first falls below 1/√2, from above zero."""
    values, vectors = np.linalg.eig(loops)
    n = loops.shape[1]
    command = np.zeros((n, joints))
    command[n - joints :] = -np.eye(joints)
    right = np.linalg.solve(vectors, np.broadcast_to(command, (len(loops), n, joints)))
    residues = vectors[:, :joints].transpose(0, 2, 1) * right  # (members, mode, joint)
    sizes = np.abs(values)
    low, high = 0.02 * sizes.min(), 5.0 * sizes.max()
    frequencies = np.geomspace(low, high, max(2, int(PER_DECADE * np.log10(high / low))))
    response = np.empty((len(loops), len(frequencies), joints))
    for k, member in enumerate(residues):
        response[k] = np.abs((1.0 / (1j * frequencies[:, None] - values[k])) @ member)
    return np.column_stack([_crossing(frequencies, response[:, :, j]) for j in range(joints)])


def _crossing(frequencies: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Where each row falls below 1/√2, interpolated in log scales; 0 for one that begins below."""
    limit, found = np.sqrt(0.5), []
    logs = np.log(frequencies)
    for row in response:
        below = np.flatnonzero(row < limit)
        if not len(below) or below[0] == 0:
            found.append(0.0 if len(below) else frequencies[-1])
            continue
        k = below[0]
        fraction = np.log(row[k - 1] / limit) / np.log(row[k - 1] / row[k])
        found.append(float(np.exp(logs[k - 1] + fraction * (logs[k] - logs[k - 1]))))
    return np.array(found)


# The H∞ gain of the nominal robot -----------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class LinearDesign:
    """A gain and its levels.

    Attributes
    ----------
    gain : (m, n)
        u − u* = K x.
    p : (n, n)
        V = ½ xᵀ P x.
    gamma, gamma_star : float
        Of the design, and the smallest feasible one (to `ROUGH`).
    """

    gain: np.ndarray
    p: np.ndarray
    gamma: float
    gamma_star: float


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
        family: LinearFamily, rows: np.ndarray, command: bool, torques: np.ndarray | None = None
    ) -> LinearProblem:
        """With h(x) = C x, R2 = I, and disturbances by the command and by torques.

        Parameters
        ----------
        rows : (s, n)
            C.
        command : bool
            Whether the command is a disturbance, through ė = q − d.
        torques : (2 joints, k) or None
            Which torques at links and motors disturb.
        """
        a, b2 = family.nominal
        n, joints = len(a), len(family.joints)
        enter = np.zeros((n, joints))
        enter[n - joints :] = -np.eye(joints)
        parts = ([enter] if command else []) + ([] if torques is None else [family.torques @ torques])
        return LinearProblem(a, np.hstack(parts), b2, rows, np.eye(b2.shape[1]))

    def linear_part(self) -> LinearPart:
        """As the synthesis has it, the input in units of its price."""
        root = np.linalg.cholesky(self.r2)
        names = tuple(f"x{k + 1}" for k in range(len(self.a)))
        return LinearPart(self.a, self.b1, np.linalg.solve(root, self.b2.T).T, self.c, names)

    def gamma_star(self) -> float:
        """Smallest feasible level, to `ROUGH`."""
        return linear_smallest_gamma(self.linear_part(), ROUGH)

    def design(self, gamma: float, gamma_star: float) -> LinearDesign:
        """The gain −R2⁻¹ B2ᵀ P at a level."""
        third = {0: self.b1[:, :, None]}
        plant = PolynomialPlant.from_parts(
            len(self.a), {1: self.a}, third, {0: self.b2[:, :, None]}, {1: self.c}, self.r2
        )
        p = linear_law(plant, gamma).P
        return LinearDesign(-np.linalg.solve(self.r2, self.b2.T @ p), p, gamma, gamma_star)

    def attained(self, gain: np.ndarray) -> float:
        """H∞ norm from d to z of the loop of a stabilising gain: the level that it attains, to `ROUGH`."""
        closed = np.vstack([self.c, np.linalg.cholesky(self.r2).T @ gain])
        nothing = np.zeros((len(self.a), 1))
        part = self.linear_part()
        return linear_smallest_gamma(
            LinearPart(self.a + self.b2 @ gain, self.b1, nothing, closed, part.state_names), ROUGH
        )
