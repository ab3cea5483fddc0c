"""Twists and inputs of a robot that rests at another pose than the command's, by the model of an estimator.

A governor shows the law joints beside their command. A robot at rest at link positions q has

    θ* = T q + K⁻¹ T⁻ᵀ G(q),    u* = what holds T⁻ᵀ G(q),

so beside the motion of the command it is shown θ_d + θ*(q) − θ*(q_d) and u_d + u*(q) − u*(q_d): what the command
accelerates stays. Springs of gears have curves, which models of estimators leave out and commands do not. With x the
twist of the model's spring, and dz(x, w) = x − clip(x, −w, w), theirs under the same torque is

    δ(x) = x/c₁ + (1/c₂ − 1/c₁) dz(x, x₁) + (1/c₃ − 1/c₂) dz(x, x₂).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from flexhinf.codegen import gives
from flexhinf.plant import Estimator
from flexhinf.plant.joints import coupling_of, joint_places, standstill_function
from flexhinf.scalars import apply, clip


@dataclass(frozen=True)
class Statics:
    """Equilibria of a robot with the states that a law reads."""

    standstill: ca.Function  # (q, parameters) → state and input at rest, of the model
    links: tuple[int, ...]  # places of the link positions in the law's state
    motors: tuple[
        tuple[int, int, int], ...
    ]  # with a spring: joint, place in the law's state, and in the model's
    coupling: np.ndarray  # T
    takes_positions: bool  # whether inputs are positions of motors, which move with the twists

    @staticmethod
    def of(estimator: Estimator | None, own: Sequence[int]) -> Statics | None:
        """That of an estimator's model, of whose states the law's are those at `own`, () where they are the same; None
        without one, where `standstill_function` knows no equilibria, or the law does not read all positions."""
        if estimator is None or (standstill := standstill_function(model := estimator.plant)) is None:
            return None
        links, _, motors, _ = joint_places(model)
        read = {place: k for k, place in enumerate(own or range(model.n))}
        elastic = [k for k in range(len(links)) if motors[k] != links[k]]
        if not {*links, *motors} <= {*read}:
            return None
        turned = coupling_of(model)
        return Statics(
            standstill,
            tuple(read[link] for link in links),
            tuple((k, read[motors[k]], int(motors[k])) for k in elastic),
            np.eye(len(links)) if turned is None else turned,
            "drive_stiffness" in model.parameters.values,
        )

    @gives("governed_command")
    def shifted(self, r: Any, command: Any, parameters: Any, *curves: Any) -> Any:
        """The command (n + m,) at whose link positions a robot rests as it does at those of r; with `curves` (5, k) of
        the springs."""
        found, inputs = list(command), len(self.links)
        there, here = (self._standstill(x, parameters, *curves) for x in (command, r))
        moved = there - here
        for _, motor, place in self.motors:
            found[motor] = r[motor] + moved[place]
        for k in range(-inputs, 0):
            found[k] = r[k] + moved[k]
        return np.array(found)

    def _standstill(self, x: Any, parameters: Any, *curves: Any) -> Any:
        """State and input at rest at the link positions of a command."""
        q = np.array([x[place] for place in self.links])
        found = list(apply(self.standstill, q, parameters)[0])
        for joint, _, place in self.motors if curves else ():
            twist = found[place] - self.coupling[joint] @ q
            more = _curved(twist, *curves[0][:, joint]) - twist
            found[place] = found[place] + more
            if self.takes_positions:
                input = joint - len(q)
                found[input] = found[input] + more
        return np.array(found)


def _curved(twist: Any, first: Any, second: Any, third: Any, low: Any, high: Any) -> Any:
    """δ(x)."""
    beyond = twist - clip(twist, -low, low), twist - clip(twist, -high, high)
    return twist / first + (1.0 / second - 1.0 / first) * beyond[0] + (1.0 / third - 1.0 / second) * beyond[1]
