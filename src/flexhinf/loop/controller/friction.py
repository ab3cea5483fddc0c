"""Feedforward of dry friction by the commanded speeds of the motors, a part of the controller's step.

A command (x_d, u_d) is a motion of a robot without dry friction. The step adds what turning a motor at its commanded
speed v takes beside that, in units of the input:

    u_F = F tanh((4 v / v₀)³)

F is Coulomb's friction and v₀ the velocity over which the robot's model smooths it. A command that rests adds nothing,
and one with noise below v₀/12 less than 4 % of F. From v₀/3 on it is all of F: where it ended earlier before a goal,
the motor would stick so much before it. It is the commanded speed and not the measured one, so no loop is closed by it.
The estimator's model has no dry friction: what it is told of an input is the rest of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from flexhinf.codegen import gives
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.validation import real_array, value_text

#: The model's smoothing over that of the feedforward. With 1, a wrist that came in slowly stuck 1.2 mrad before a goal.
SHARPNESS = 4.0


@dataclass(frozen=True)
class DryFriction:
    """Dry friction that a controller overcomes along a moving reference.

    Parameters
    ----------
    level : (m,)
        Coulomb's friction of each motor in units of its input, at least 0.
    smoothing : (m,)
        Velocity over which it is smoothed, rad/s or m/s, positive.
    speeds : sequence of str
        Of each motor the state that is its velocity.

    Raises
    ------
    InvalidInput
        If the three do not fit each other, or are no such numbers.
    """

    level: Sequence[float]
    smoothing: Sequence[float]
    speeds: Sequence[str]

    def __post_init__(self) -> None:
        level, smoothing, count = real_array(self.level), real_array(self.smoothing), len(self.speeds)
        refuse_if(
            level.shape != (count,) or smoothing.shape != (count,)
            or not (np.all(np.isfinite(level) & (level >= 0.0)) and np.all(np.isfinite(smoothing) & (smoothing > 0.0))),
            "The dry friction does not fit the motors.",
            f"expected levels >= 0 and velocities > 0 for {list(self.speeds)}, got {value_text(self.level)} and "
            f"{value_text(self.smoothing)}",
            "one number per motor, in units of its input and of its speed",
        )  # fmt: skip
        vars(self).update(
            level=tuple(level.tolist()), smoothing=tuple(smoothing.tolist()), speeds=tuple(self.speeds)
        )

    def settings(self) -> dict[str, Any]:
        """The arguments as lists, for a file."""
        return {name: list(value) for name, value in asdict(self).items()}

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


def friction_input(places: Sequence[int], command: Any, level: Any, smoothing: Any) -> Any:
    """What the motors need beside u_d of a command (x_d, u_d), (m,), on any element."""
    ratio = SHARPNESS * command[list(places)] / smoothing
    return level * np.tanh(ratio * ratio * ratio)


def overcoming(places: Sequence[int], input: Any, *command: Any) -> Any:
    """An input (m,) with what dry friction takes; for `command` see `friction_input`."""
    return input + friction_input(places, *command)


@gives("*modelled")
def modelled(
    places: Sequence[int], level: Any, smoothing: Any, command: Any, *others: Any
) -> tuple[Any, ...]:
    """Inputs (m,) as a model without dry friction has them.

    `others` are, of several inputs, the commands (N, k) before the last `command`, and then the inputs, newest first.
    """
    several = len(others) > 1
    commands = [command, *(others[0] if several else [])]
    inputs = others[1:] if several else others
    return tuple(
        u - friction_input(places, r, level, smoothing) for u, r in zip(inputs, commands, strict=True)
    )
