"""What a gain makes of a family of linearised robots: bandwidth, and damping of the oscillations.

The command acts through the integral of the error alone, as in a step that the controller begins without a jump of
the input. Each joint's bandwidth is where |command → link position| first falls below 1/√2. Every oscillation counts,
not only those that are told as vibrations of a spring: a dial of damping that is turned far slows a vibration down
until it is one with the motion of the whole, and its damping falls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexhinf.design.modes import modes_of
from flexhinf.design.presets.linear_family import LinearFamily

__all__ = ["Behaviour", "behaviour_of", "worst_members"]

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
    """

    bandwidth: np.ndarray
    damping: float
    nominal_damping: float


def behaviour_of(family: LinearFamily, gain: np.ndarray) -> Behaviour:
    """Of u = u* + K x, K (m, n)."""
    loops = family.a + family.b @ gain
    damping = [_damping(family, loop) for loop in loops]
    stable = min(damping) > -np.inf
    joints = len(family.joints)
    bandwidths = _bandwidths(loops, joints).min(axis=0) if stable else np.zeros(joints)
    return Behaviour(bandwidths, min(damping), damping[0])


def worst_members(family: LinearFamily, gain: np.ndarray) -> list[int]:
    """The members with the smallest bandwidth of each joint, and with the smallest damping."""
    loops = family.a + family.b @ gain
    damping = [_damping(family, loop) for loop in loops]
    worst = [int(np.argmin(damping))]
    if min(damping) > -np.inf:
        worst += [int(k) for k in np.argmin(_bandwidths(loops, len(family.joints)), axis=0)]
    return worst


def _damping(family: LinearFamily, loop: np.ndarray) -> float:
    modes = modes_of(loop, family.joints, *family.energy)
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
        share = np.log(row[k - 1] / limit) / np.log(row[k - 1] / row[k])
        found.append(float(np.exp(logs[k - 1] + share * (logs[k] - logs[k - 1]))))
    return np.array(found)
