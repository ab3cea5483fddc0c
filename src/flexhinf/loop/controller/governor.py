"""A governor of the command about which a law acts: joints that are far from it are brought back slowly.

A law is nearly linear. A joint that something has held a radian from its command, or whose command jumps by as much, is
asked to come back as fast as a linear loop would, far beyond its speed limit. So of a joint that is farther from its
command than a distance d, the law is shown another motion. It begins where the last one was, stays within d of the
joint, and follows the command x_d as a planner would, with an acceleration a and at most a speed s in all:

    v = v_d − sign(l) min(s/2, √(a |l|), k |l|),    l = x − x_d.

Link and motor are shifted alike, so the twist of the spring, and the input u_d, stay those of the command; the law
takes what the other pose needs beside them. Where the lag l is gone, the law is shown the command itself again, bit for
bit.

While something holds the joint, an error of d is integrated, and not one that grows: no integral stands still, as it
may be what carries a payload. A joint that comes loose thus overshoots with the motion that is shown at d from it.
There the integral is taken back by the whole error, as without a governor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.codegen import gives
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.loop.controller.measured import Source, positions
from flexhinf.loop.controller.options import Listed
from flexhinf.loop.controller.status import Supervision
from flexhinf.scalars import absolute, clip, maximum, minimum, where
from flexhinf.validation import real_array, value_text

#: Largest k, 1/s, of the last of a lag, and the same in parts of the lag per sample. Share of the distance at which a
#: lag is over. A slower end, of 10 1/s, left joints with dry friction sticking 12 mrad beside their goal.
RATE, PER_SAMPLE, OVER = 40.0, 0.2, 1e-3

#: A number without a sign to speak of, whose root has a slope.
TINY = 1e-18

#: Of a tracked position the states that are shifted with it; a rigid joint has no motor of its own.
KINDS = ("link_position", "link_velocity", "motor_position", "motor_velocity")


@dataclass(frozen=True)
class Governor(Listed):
    """How a controller about a moving reference brings joints back that are far from their command.

    Parameters
    ----------
    distance : (k,)
        From its command, rad or m, beyond which a joint is brought back; so far the motion that is shown to the law is
        from the joint at most. Positive, and larger than the errors of a loop that works.
    speed : (k,)
        Largest speed of that motion, rad/s or m/s, or that of the command where it is faster. Half of it is by how much
        the motion may be faster than the command.
    acceleration : (k,)
        Of that motion, rad/s² or m/s².
    lower, upper : (k,)
        Range of the joints, rad or m, which that motion does not leave by itself.

    Raises
    ------
    InvalidInput
        If sizes differ, numbers are not positive, or a range is empty.
    """

    distance: Sequence[float]
    speed: Sequence[float]
    acceleration: Sequence[float]
    lower: Sequence[float]
    upper: Sequence[float]

    def __post_init__(self) -> None:
        rows = {name: real_array(value) for name, value in vars(self).items()}
        sizes = [rows.pop(name) for name in ("lower", "upper")]
        alike = len({row.shape for row in (*sizes, *rows.values())}) == 1 and sizes[0].ndim == 1
        refuse_if(
            not alike or not all(np.all(np.isfinite(row) & (row > 0.0)) for row in rows.values())
            or not np.all(sizes[0] <= sizes[1]),
            "The governor of a controller does not fit the joints.",
            "expected a positive distance, speed and acceleration for each joint and lower <= upper, got "
            f"{value_text(vars(self))}",
            "one number per tracked position: Governor([0.05], [1.0], [3.0], [-3.0], [3.0])",
        )  # fmt: skip
        vars(self).update({name: tuple(real_array(value).tolist()) for name, value in vars(self).items()})

    @property
    def text(self) -> str:
        """From how far on and how fast, for a summary."""
        rows = ", ".join(f"{far:.3g} at {speed:.3g} per s" for far, speed in zip(self.distance, self.speed))
        return f"joints farther from their command than {rows} at most"

    def places(
        self, states: Sequence[str], tracked: Sequence[str], moving: bool, supervision: Supervision | None
    ) -> tuple[tuple[int, ...], ...]:
        """Places of the states that are shifted (k, 4), see `KINDS`; refused where a law has no such states, the
        reference does not move, or a following error holds the joints where they are."""
        rows = [[name.replace(KINDS[0], kind) for kind in KINDS] for name in tracked]
        own = [[n if n in states else n.replace("motor", "link") for n in row] for row in rows]
        frozen = supervision is not None and supervision.reactions.get("following") == "hold"
        fits = len(rows) == len(self.distance) and all(set(row) <= set(states) for row in own)
        if not (moving and fits and all(KINDS[0] in name for name in tracked)) or frozen:
            raise InvalidInput(
                "A governor does not fit the controller.",
                f"expected moving=True, {len(self.distance)} tracked link positions with their velocities, and no "
                f"reaction 'hold' to a following error, got moving={moving}, {list(tracked)} of {list(states)}"
                + ", 'hold'"
                * frozen,
                "governor=None; for commands that stand command_rate=…, and 'brake' in place of 'hold'",
            )
        return tuple(tuple(states.index(name) for name in row) for row in own)

    def data(self, period: float) -> np.ndarray:
        """Numbers of the step (6, k)."""
        last = np.full(len(self.distance), min(RATE, PER_SAMPLE / period))
        return np.array([self.distance, self.speed, self.acceleration, self.lower, self.upper, last])


@gives("governed_command", "far_next", "unwinding")
def governed(
    tracked: Sequence[Source],
    places: Sequence[Sequence[int]],
    y: Any,
    estimate: Any,
    r: Any,
    last: Any,
    far: Any,
    started: Any,
    period: Any,
    numbers: Any,
) -> tuple[Any, Any, Any]:
    """The command (n + m,) that the law is shown in place of r, the joints that are brought back (k,), 1 or 0, and of
    those at the distance from it the lag (k,), else 0. `last` is the command that it was shown before."""
    command, flags, lags = list(r), [], []
    for row, seen, flag, *own in zip(places, positions(tracked, y, estimate), far, *numbers):
        link, turning, *_ = row
        before = where(started[0] > 0.5, last[link], seen)
        speed = where(started[0] > 0.5, last[turning], 0.0)
        place, faster, clipped = _followed(r[link], r[turning], seen, before, speed, period[0], own)
        lag, ahead = place - r[link], faster - r[turning]
        slow = where(absolute(ahead) > 2.0 * period[0] * own[2], 0.0, 1.0)
        flag = where(absolute(r[link] - seen) > own[0], 1.0, flag)
        flag = where(absolute(lag) > OVER * own[0], flag, flag * (1.0 - slow))
        lag, ahead = where(flag > 0.5, lag, 0.0), where(flag > 0.5, ahead, 0.0)
        for each, shift in dict(zip(row, (lag, ahead, lag, ahead))).items():
            command[each] = r[each] + shift
        flags.append(flag)
        lags.append(where(clipped > 0.0, lag, 0.0))
    return np.array(command), np.array(flags), np.array(lags)


def _followed(
    goal: Any, velocity: Any, seen: Any, before: Any, speed: Any, period: Any, numbers: Sequence[Any]
) -> tuple[Any, Any, Any]:
    """Position and speed of the motion that is shown of a joint, after those of the last sample, and by how much the
    joint, which is `seen`, keeps it back."""
    distance, most, acceleration, lower, upper, rate = numbers
    lag, step = before - goal, period * acceleration
    size = absolute(lag)
    back = minimum(minimum(0.5 * most, np.sqrt(acceleration * size + TINY)), rate * size)
    fastest = maximum(most, absolute(velocity))
    aim = clip(velocity - where(lag > 0.0, back, -back), -fastest, fastest)
    aim = clip(aim, speed - step, speed + step)
    free = clip(
        before + period * aim, minimum(lower, minimum(goal, before)), maximum(upper, maximum(goal, before))
    )
    place = clip(free, seen - distance, seen + distance)
    kept = free - place
    # A joint that keeps the motion back stops it; one that is ahead of it does not make it faster.
    return place, where(kept * aim > 0.0, clip(0.0, speed - step, speed + step), aim), absolute(kept)


def unwound(error: Any, integral: Any, lag: Any) -> Any:
    """The errors (k,) that are integrated: those that take an integral back count from the command itself, of joints
    that are beyond what is shown of it."""
    rows = zip(error, integral, lag, strict=True)
    return np.array([where(e * i < 0.0, e + where(e * s > 0.0, s, 0.0), e) for e, i, s in rows])
