"""Feedforward of dry friction by the commanded speeds of the motors, a part of the controller's step.

A command (x_d, u_d) is a motion of a robot without dry friction. The step adds what turning a motor at its commanded
speed v takes beside that, in units of the input:

    u_F = F tanh((4 v / v₀)³)

F is Coulomb's friction F_c, or with Stribeck's curve F_c + (F_s − F_c) exp(−(v / v_s)²), and v₀ the velocity over which
the robot's model smooths it. A command that rests adds nothing,
and one with noise below v₀/12 less than 4 % of F. From v₀/3 on it is all of F: where it ended earlier before a goal,
the motor would stick so much before it. It is the commanded speed and not the measured one, so no loop is closed by it.
The estimator's model has no dry friction: what it is told of an input is the rest of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.codegen import gives
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.loop.controller.options import Listed
from flexhinf.validation import real_array, value_text

#: The model's smoothing over that of the feedforward. With 1, a wrist that came in slowly stuck 1.2 mrad before a goal.
SHARPNESS = 4.0


@dataclass(frozen=True)
class DryFriction(Listed):
    """Dry friction that a controller overcomes along a moving reference.

    Parameters
    ----------
    level : (m,)
        Coulomb's friction of each motor in units of its input, at least 0.
    smoothing : (m,)
        Velocity over which it is smoothed, rad/s or m/s, positive.
    speeds : sequence of str
        Of each motor the state that is its velocity.
    static, stribeck : (m,), optional
        Static friction in units of the input, at least 0, and the velocity by which it has fallen to the level, rad/s
        or m/s, positive; both, or None for a level at all speeds.

    Raises
    ------
    InvalidInput
        If these do not fit each other, or are no such numbers.
    """

    level: Sequence[float]
    smoothing: Sequence[float]
    speeds: Sequence[str]
    static: Sequence[float] | None = None
    stribeck: Sequence[float] | None = None

    def __post_init__(self) -> None:
        stated = {name: getattr(self, name) for name in ("level", "smoothing", "static", "stribeck")}
        kept = {name: real_array(value) for name, value in stated.items() if value is not None}
        refuse_if(
            len(kept) % 2
            or any(
                each.shape != (len(self.speeds),) or not np.all(np.isfinite(each)) for each in kept.values()
            )
            or any(
                np.any(each < 0.0 if name in ("level", "static") else each <= 0.0)
                for name, each in kept.items()
            ),
            "The dry friction does not fit the motors.",
            f"expected levels >= 0 and velocities > 0 for {list(self.speeds)}, got {value_text(stated)}",
            "one number per motor, in units of its input and of its speed",
        )
        vars(self).update(
            {name: tuple(each.tolist()) for name, each in kept.items()}, speeds=tuple(self.speeds)
        )

    @property
    def table(self) -> np.ndarray:
        """The numbers of the step, (2, m) or with Stribeck's curve (4, m): level, smoothing, static, stribeck."""
        rows = (self.level, self.smoothing, self.static, self.stribeck)
        return np.array([row for row in rows if row is not None])

    def places(self, states: Sequence[str], inputs: Sequence[str], moving: bool) -> tuple[int, ...]:
        """Places of the speeds among a law's states; refused where these are others, or nothing moves."""
        if not moving or len(self.speeds) != len(inputs) or not set(self.speeds) <= set(states):
            raise InvalidInput(
                "The dry friction does not fit the controller.",
                f"expected moving=True, and one of {list(states)} for each of {list(inputs)}, got moving={moving} and "
                f"{list(self.speeds)}",
                "moving=True and the velocities of its motors, or dry_friction=None",
            )
        return tuple(states.index(name) for name in self.speeds)


def friction_input(places: Sequence[int], command: Any, table: Any) -> Any:
    """What the motors need beside u_d of a command (x_d, u_d), (m,), on any element; `table` is `DryFriction.table`."""
    (level, smoothing, *stribeck), speed = table, command[list(places)]
    if stribeck:
        static, slow = stribeck
        share = speed / slow
        level = level + (static - level) * np.exp(-(share * share))
    ratio = SHARPNESS * speed / smoothing
    return level * np.tanh(ratio * ratio * ratio)


def overcoming(places: Sequence[int], input: Any, command: Any, table: Any) -> Any:
    """An input (m,) with what dry friction takes; for the others see `friction_input`."""
    return input + friction_input(places, command, table)


@gives("modelled")
def modelled(places: Sequence[int], input: Any, command: Any, table: Any) -> Any:
    """An input (m,) as a model without dry friction has it."""
    return input - friction_input(places, command, table)
