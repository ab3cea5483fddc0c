"""Penalties on more than states: the torque of the springs and its rate, which sees the vibrations alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.plant import Penalty
from flexhinf.plant.penalty import unknown_weight
from flexhinf.robot.elastic import Layout
from flexhinf.robot.signals import names_of


@dataclass(frozen=True)
class WeightedStatesAndTorques:
    """h(x): weighted states, then weighted torques K (q2 − q1) of the springs and their rates, as deviations.

    Parameters
    ----------
    states : tuple of float
        One weight per state, integrals included.
    torques, rates : tuple of float
        One weight per elastic joint, 1/(N·m) or 1/N, and s/(N·m) or s/N.
    layout : Layout, optional
        Of the state; by default all joints are elastic.
    """

    states: tuple[float, ...]
    torques: tuple[float, ...]
    rates: tuple[float, ...]
    layout: Layout | None = None

    def __call__(self, x: Any, p: Any) -> Any:
        """h (s,) of any element."""
        layout = Layout(len(self.torques)) if self.layout is None else self.layout
        q, dq, theta, dtheta = layout.split(x)
        if layout.rigid:
            q, dq = q[layout.elastic], dq[layout.elastic]
        torque, rate = p.stiffness * (theta - q), p.stiffness * (dtheta - dq)
        weighted = [weight * x[i] for i, weight in enumerate(self.states) if weight]
        for weights, values in ((self.torques, torque), (self.rates, rate)):
            weighted += [weight * values[i] for i, weight in enumerate(weights) if weight]
        return np.array(weighted)


def robot_penalty(
    penalty: Penalty,
    joints: Sequence[str],
    states: Sequence[str],
    groups: Mapping[str, Sequence[str]] | None = None,
    layout: Layout | None = None,
) -> Penalty:
    """The penalty as the plant understands it: one without torques stays as it is.

    Parameters
    ----------
    penalty : Penalty
        Single names only, see `Penalty.expanded`.
    joints, states : sequence of str
        Names; the states with the integrals.
    groups : mapping of str to sequence of str
        Plain names that stand for all joints, which an error lists first.
    layout : Layout, optional
        Which joints have a spring; all by default.

    Raises
    ------
    InvalidInput
        For a weight of something that is neither a state nor a spring's torque.
    """
    layout = Layout(len(joints)) if layout is None else layout
    rigid = [joints[i] for i in layout.rigid]
    named = [names_of(quantity, joints, rigid) for quantity in ("joint_torque", "joint_torque_rate")]
    if not isinstance(penalty.states, Mapping):
        return penalty
    singles = (*states, *named[0], *named[1])
    plain = [group for group, members in (groups or {}).items() if set(members) <= set(singles)]
    known = dict.fromkeys((*plain, *singles))
    if unknown := [name for name in penalty.states if name not in known]:
        raise unknown_weight(unknown[0], list(known))
    if not {*named[0], *named[1]} & set(penalty.states):
        return penalty
    weights = dict(penalty.states)
    torques, rates = (tuple(float(weights.pop(name, 0.0)) for name in names) for names in named)
    kept = replace(penalty, states=weights).weights(states)
    return replace(penalty, states=WeightedStatesAndTorques(tuple(kept.tolist()), torques, rates, layout))
