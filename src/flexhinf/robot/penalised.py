"""Penalties on more than states: the torque of the springs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.plant import Penalty
from flexhinf.robot.signals import signal_names

__all__ = ["WeightedStatesAndTorques", "robot_penalty"]


@dataclass(frozen=True)
class WeightedStatesAndTorques:
    """h(x): weighted states, then weighted torques K (q2 − q1) of the springs, all as deviations.

    Parameters
    ----------
    states : tuple of float
        One weight per state, integrals included.
    torques : tuple of float
        One weight per joint, 1/(N·m) or 1/N.
    """

    states: tuple[float, ...]
    torques: tuple[float, ...]

    def __call__(self, x: Any, p: Any) -> Any:
        """h (s,) of any element."""
        n = len(self.torques)
        torque = p.stiffness * (x[2 * n : 3 * n] - x[:n])
        weighted = [weight * x[i] for i, weight in enumerate(self.states) if weight]
        return np.array([*weighted, *(weight * torque[i] for i, weight in enumerate(self.torques) if weight)])


def robot_penalty(penalty: Penalty, joints: Sequence[str], states: Sequence[str]) -> Penalty:
    """The penalty as the plant understands it: one without torques stays as it is.

    Parameters
    ----------
    penalty : Penalty
        Single names only, see `Penalty.expanded`.
    joints, states : sequence of str
        Names; the states with the integrals.

    Raises
    ------
    InvalidInput
        For a weight of something that is neither a state nor a spring's torque.
    """
    torques = signal_names("joint_torque", joints)
    if not isinstance(penalty.states, Mapping) or not set(torques) & set(penalty.states):
        return penalty
    weights = dict(penalty.states)
    each = tuple(float(weights.pop(name, 0.0)) for name in torques)
    kept = replace(penalty, states=weights).weights(states)
    return replace(penalty, states=WeightedStatesAndTorques(tuple(kept.tolist()), each))
