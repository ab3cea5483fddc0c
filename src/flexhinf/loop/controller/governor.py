"""A governor of the command about which a law acts: joints that are far from it are brought back slowly.

A law is nearly linear. A joint that something has held a radian from its command, or whose command jumps by as much, is
asked to come back as fast as a linear loop would, far beyond its speed limit. So of a joint that is farther from its
command than a distance d, the law is shown another motion. It begins where the last one was, stays within d of the
joint, and follows the command x_d as a planner would, with an acceleration a and at most a speed s in all:

    v = v_d − sign(l) min(s/2, √(a |l|), k |l|),    l = x − x_d.

What the command itself accelerates comes on top of a, or a joint that is late could not brake with it before the goal.
The law is shown all of the other pose: the gains are those there, and the twists of the springs and the inputs are
those of the command and what the robot at rest needs more there, by the estimator's model with its payload,

    θ = θ_d + θ*(q) − θ*(q_d),    u = u_d + u*(q) − u*(q_d),    θ* = T q + K⁻¹ T⁻ᵀ G(q).

With the weight at the command in their place, a raised arm that was pushed cycled for ever. Without an estimator, or
where its model is no such robot, link and motor are shifted alike, and the law takes what the other pose needs. Where
the lag l is gone, the law is shown the command itself again, bit for bit.

A joint that something pushes comes back as the law itself brings it. To be shown a motion that runs away with the joint
takes from the law what brakes it: with a soft spring the joint went three times as far, and a law at the limits of its
motor never came to rest. A far joint that runs away, by itself faster than v_d + `AWAY` s, is *pushed*, then and for
`PUSHED` after it last ran away: where a load of more than w moves it, see below; where its command stands and it was
not far before; or where another joint is pushed, which carries it. The motion is not held at a pushed joint, and its
integral and its velocity count as without a governor. Beside a joint that lets go none begins to be pushed. Where one
is still far afterwards, the motion goes to it with the speed s.

While something holds the joint, an error of d is integrated, and not one that grows: no integral stands still, as it
may be what carries a payload. A joint that comes loose thus overshoots with the motion that is shown at d from it.
There the integral is taken back by the whole error, as without a governor.

An obstacle, or somebody who holds the arm, looks like a payload that nobody knows, but is larger. What the correction
of the estimate adds to the velocity of a link is the acceleration p that the estimator's model does not explain. Of a
joint that is brought back, and that p keeps from it by more than the *resistance* w of the tolerances, the motion comes
as near as p is large: it stays within g d of the joint, and

    ġ = (1 − |p|/w)/t,    0 ≤ g ≤ 1,    t = `REGRIP` where g grows, else `LET_GO`.

So the joint lets go of the obstacle but for a push of about w, springs are not loaded, and integrals stand still. The
speed of the motion is then g times `TOUCH` of its largest one at most. An obstacle does not move a joint. Where p
does so, by `YIELDED` of the distance away from the command, it is a load, of a joint that is not far yet too, and the
joint grips until p is small. Where nothing keeps it back, g is 1.

A link that is blocked stands, but its estimate moves, by what the spring would make of a free one: at tens of rad/s of
a light link. A law that damps these winds the spring up, and keeps it wound. So of the velocity of such a link, where
it has a spring, it hears 2 − |p|/w, at most 1 and at least 0; what it hears of the motor's relaxes the spring. Of p no
more than 2 w is kept, or a blow would be heard when the joint is free again, and be taken for a load.

A joint that is let go of may outrun the motion that it is shown, by what its integral holds. Such an integral is taken
back within `TAKEN_BACK`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial, reduce
from typing import Any

import numpy as np

from flexhinf.codegen import gives
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.loop.controller.measured import Source, positions
from flexhinf.loop.controller.options import Listed
from flexhinf.loop.controller.statics import Statics
from flexhinf.loop.controller.status import Supervision
from flexhinf.numerals import number_text
from flexhinf.plant import Estimator, Law
from flexhinf.scalars import absolute, clip, maximum, minimum, where
from flexhinf.validation import real_array, value_text

#: Largest k, 1/s, of the last of a lag, and the same in parts of the lag per sample. Share of the distance at which a
#: lag is over. A slower end, of 10 1/s, left joints with dry friction sticking 12 mrad beside their goal.
RATE, PER_SAMPLE, OVER = 40.0, 0.2, 1e-3

#: What resists a joint is heard with this time constant, s; times t in which a joint lets go and grips again, s; share
#: of the resistance below which nothing keeps the joint, and of the distance by which a load moves it.
HEARD, LET_GO, REGRIP, QUIET, YIELDED = 0.02, 0.03, 0.3, 0.5, 0.25

#: Of what resists a joint so many resistances are heard; one less, and its link's velocity counts less; all of them,
#: and it is brought back from this share of the distance on. More, and a blow of 20 would be heard for 60 ms.
MOST, SOONER = 2.0, 0.25

#: Share of its largest speed with which a joint comes back while it grips again: a rotor that touches the obstacle with
#: v winds the spring by v sqrt(K J), which throws a light link with many times v if that goes then.
TOUCH = 0.1

#: Integrals that drive a joint faster than it is shown are taken back with this time constant, s: wholly where it is
#: faster by the second of two shares of the largest speed, not at all below the first. A light rotor is at its speed
#: limit in 8 ms, which 10 ms and 75 % let reach 1.7 times that; within one sample joints sag that carry a payload.
TAKEN_BACK, FASTER, MUCH_FASTER = 0.002, 0.2, 0.4

#: A far joint that leaves its command with this share of its largest speed runs away; for so long after, s, it is
#: pushed. A law takes 0.5 s for the way back, or 1 s at the limit of its motor. A slower joint turns before it is far;
#: estimates show half of the speed of a push at first.
AWAY, PUSHED = 0.25, 1.0

#: A number without a sign to speak of, whose root has a slope.
TINY = 1e-18

#: Arguments that are tables, and those of a curve's numbers that are stiffnesses.
TABLES, SLOPES = ("coupling", "curves"), 3

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
    resistance : (k,), optional
        Acceleration of each joint, rad/s² or m/s², that the estimator's model does not explain, and above which a joint
        that is brought back lets go of what keeps it. It needs an estimator; None: joints push on.
    coupling : (k, k), optional
        T of a robot whose motors move more than their own joints, θ = T q.
    curves : (5, k), optional
        Of springs that the commands have with the curve of a gear, and the estimator's model straight: the stiffness in
        three parts of the curve, over that of the model, and the twists of the model's spring, rad or m, at the torques
        between them.

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
    resistance: Sequence[float] | None = None
    coupling: Sequence[Sequence[float]] | None = None
    curves: Sequence[Sequence[float]] | None = None

    def __post_init__(self) -> None:
        stated = {
            name: value for name, value in vars(self).items() if value is not None and name not in TABLES
        }
        rows = {name: real_array(value) for name, value in stated.items()}
        sizes = [rows.pop(name) for name in ("lower", "upper")]
        alike = len({row.shape for row in (*sizes, *rows.values())}) == 1 and sizes[0].ndim == 1
        refuse_if(
            not alike
            or not all(np.all(np.isfinite(row) & (row > 0.0)) for row in rows.values())
            or not np.all(sizes[0] <= sizes[1])
            or (self.coupling is not None and np.shape(self.coupling) != 2 * sizes[0].shape)
            or not _are_curves(self.curves, sizes[0].size),
            "The governor of a controller does not fit the joints.",
            "expected a positive distance, speed, acceleration, resistance and curve for each joint and lower <= "
            f"upper, got {value_text(vars(self))}",
            "one number per tracked position: Governor([0.05], [1.0], [3.0], [-3.0], [3.0])",
        )
        vars(self).update({name: tuple(real_array(value).tolist()) for name, value in stated.items()})
        for name in TABLES:
            if (rows := vars(self)[name]) is not None:
                vars(self)[name] = tuple(tuple(row) for row in real_array(rows).tolist())

    def text_in(self, units: Sequence[str]) -> str:
        """From how far on and how fast, for a summary; `units` are those of the commanded positions (k,)."""
        speeds, accelerations = ([f"{unit}{per}" * bool(unit) for unit in units] for per in ("/s", "/s²"))
        rows = ", ".join(
            f"{number_text(far, unit, 3)} at {number_text(speed, per, 3)}"
            for far, speed, unit, per in zip(self.distance, self.speed, units, speeds)
        )
        most = ", ".join(
            number_text(size, unit, 3) for size, unit in zip(self.resistance or (), accelerations)
        )
        loose = f", let go of what resists by {most}" if most else ""
        return f"joints farther from their command than {rows} at most{loose}"

    def places(
        self,
        law: Law,
        moving: bool,
        supervision: Supervision | None,
        own: Sequence[int],
        estimator: Estimator | None,
    ) -> tuple[tuple[tuple[int, ...], ...], tuple[int, ...], tuple[tuple[float, ...], ...], bool]:
        """Places of the states that are shifted (k, 4), see `KINDS`, of velocities in an estimate with the states at
        `own`, () where no joint lets go, T of coupled joints, and whether springs have curves. Refused where a law has
        no such states, the reference does not move, a following error holds the joints where they are, or nothing says
        what resists them."""
        states, tracked = law.plant_states, law.tracked
        rows = [[name.replace(KINDS[0], kind) for kind in KINDS] for name in tracked]
        names = [[n if n in states else n.replace("motor", "link") for n in row] for row in rows]
        frozen = supervision is not None and supervision.reactions.get("following") == "hold"
        fits = len(rows) == len(self.distance) and all(set(row) <= set(states) for row in names)
        if not (moving and fits and all(KINDS[0] in name for name in tracked)) or frozen:
            raise InvalidInput(
                "A governor does not fit the controller.",
                f"expected moving=True, {len(self.distance)} tracked link positions with their velocities, and no "
                f"reaction 'hold' to a following error, got moving={moving}, {list(tracked)} of {list(states)}"
                + ", 'hold'"
                * frozen,
                "governor=None; for commands that stand command_rate=…, and 'brake' in place of 'hold'",
            )
        refuse_if(
            self.resistance is not None and estimator is None,
            "Nothing says what resists the joints of a governor.",
            "expected an estimator with a resistance, got None",
            "resistance=None: joints push on against an obstacle; or an estimator",
        )
        places = tuple(tuple(states.index(name) for name in row) for row in names)
        velocities = [row[1] for row in places] if self.resistance is not None else []
        seen = tuple(own[place] if own else place for place in velocities)
        return places, seen, tuple(map(tuple, self.coupling or ())), self.curves is not None

    def data(self, period: float) -> np.ndarray:
        """Numbers of the step (6, k)."""
        last = np.full(len(self.distance), min(RATE, PER_SAMPLE / period))
        return np.array([self.distance, self.speed, self.acceleration, self.lower, self.upper, last])


def _are_curves(curves: Any, joints: int) -> bool:
    """Whether these are numbers of curves (5, k) of so many springs, or None."""
    table = np.ones((5, joints)) if curves is None else real_array(curves)
    sizes = table.shape == (5, joints) and np.all(np.isfinite(table)) and np.all(table[:SLOPES] > 0.0)
    return bool(sizes) and bool(np.all(table[SLOPES:] >= 0.0))


def first_of_joints(mode: Any, zeros: np.ndarray) -> dict[str, np.ndarray]:
    """Parts of the memory before the first sample, of joints (k,) that all follow."""
    kept = {"hold": np.outer([1.0, 0.0, 0.0, 0.0], zeros + 1.0)} if mode.resisted else {}
    return {"far": zeros, **kept} if mode.governed else {}


def brought_back(
    run: Any,
    tracked: Sequence[Source],
    mode: Any,
    seen: tuple[Any, Any],
    r: Any,
    means: Any,
    memory: Any,
    data: Any,
    estimator: Estimator | None,
) -> tuple[Any, Any, dict[str, Any]]:
    """The command (n + m,) that the law is shown in place of r, the lag (k,) of `governed`, and what is remembered.

    `seen` are measurement and estimate, `means` (2,) that of the estimator before and after its correction."""
    kept: dict[str, Any] = {}
    if mode.resisted:
        change = run.call(partial(_corrections, mode.resisted), *means)
        kept["hold"] = run.call(
            partial(resisted, tracked, mode.governed),
            *seen,
            r,
            change,
            memory.hold,
            memory.far,
            data.period,
            data.governor,
            data.resistance,
        )
    command, kept["far"], lag = run.call(
        partial(governed, tracked, mode.governed, mode.turned),
        *seen,
        r,
        memory.reference,
        memory.command,
        memory.far,
        memory.started,
        data.period,
        data.governor,
        *kept.values(),
    )
    if (statics := Statics.of(estimator, mode.own)) is not None:
        curves = [data.governor_curves] if mode.curved else []
        command = run.call(statics.shifted, r, command, data.parameters, *curves)
    return command, lag, kept


@gives("corrections")
def _corrections(places: Sequence[int], before: Any, after: Any) -> Any:
    return np.array([after[place] - before[place] for place in places])


@gives("hold_next")
def resisted(
    tracked: Sequence[Source],
    places: Sequence[Sequence[int]],
    y: Any,
    estimate: Any,
    r: Any,
    change: Any,
    hold: Any,
    far: Any,
    period: Any,
    numbers: Any,
    resistance: Any,
) -> Any:
    """How the joints are held (4, k), by what a correction changed (k,) of their velocities: the share g of the
    distance within which their motion is shown, the acceleration that no model explains, in resistances, where the
    joint was nearest to its command since that keeps it from it, and whether it has yielded since, 1 or 0."""
    heard, columns = minimum(period[0] / HEARD, 1.0), list[list[Any]]()
    joints = zip(places, positions(tracked, y, estimate), change, far, numbers[0], resistance, *hold)
    for (link, *_), seen, gained, flag, distance, most, share, push, nearest, load in joints:
        push = clip(push + heard * (gained / (period[0] * most) - push), -MOST, MOST)
        side = where(r[link] < seen, -1.0, 1.0)
        keeps = -side * push
        nearest = where(keeps < QUIET, seen, where(side * (seen - nearest) > 0.0, seen, nearest))
        load = where(side * (nearest - seen) > YIELDED * distance, 1.0, where(keeps < QUIET, 0.0, load))
        rate = where(load > 0.5, 1.0, clip(1.0 - keeps, -1.0, 1.0) * where(keeps < 1.0, LET_GO / REGRIP, 1.0))
        share = clip(share + rate * period[0] / LET_GO, 0.0, 1.0)
        columns.append([where(flag > 1.0, 1.0, where(flag > 0.5, share, 1.0)), push, nearest, load])
    return np.array(columns).T


@gives("governed_command", "far_next", "unwinding")
def governed(
    tracked: Sequence[Source],
    places: Sequence[Sequence[int]],
    turned: Sequence[Sequence[float]],
    y: Any,
    estimate: Any,
    r: Any,
    before: Any,
    last: Any,
    far: Any,
    started: Any,
    period: Any,
    numbers: Any,
    *hold: Any,
) -> tuple[Any, Any, Any]:
    """The command (n + m,) that the law is shown in place of r, with link and motor shifted alike, the joints that are
    brought back (k,), 0 or 1, and more if they are pushed, and (3, k) of those at the distance from it the lag,
    else 0, by how much joints are faster than shown, and what counts of the velocities in the estimate. `before` is the
    command before r, `last` the one that the law was shown then, `hold` that of `resisted`, by default all of the
    distance."""
    command: list[Any] = list(r)
    flags: list[Any] = []
    lags: list[Any] = []
    outrun: list[Any] = []
    heard: list[Any] = []
    shares, pushes, _, loads = hold[0] if hold else ([each] * len(places) for each in (1.0, None, 0.0, 1.0))
    joints = zip(places, positions(tracked, y, estimate), far, shares, pushes, loads, *numbers)
    some = reduce(maximum, list(far)) > 1.0
    free = where(reduce(minimum, list(shares)) < 1.0, 0.0, 1.0)
    for row, seen, flag, share, push, load, distance, *own in joints:
        link, turning, *_ = row
        goes_on, goal, rate = started[0] > 0.5, r[link], r[turning]
        place, speed = where(goes_on, last[link], seen), where(goes_on, last[turning], 0.0)
        step = period[0] * own[1]
        step = step + where(goes_on, absolute(rate - before[turning]), 0.0)
        most = distance if push is None else where(absolute(push) < MOST, distance, SOONER * distance)
        is_far = where(absolute(goal - seen) > most, 1.0, 0.0)
        moving = seen - goal, estimate[turning], rate, AWAY * own[0]
        unlike = 1.0 if push is None else where(absolute(push) > 1.0, load, 0.0)
        runs = where(share < 1.0, 0.0, is_far * _runs_away(*moving))
        flag = _pushed(
            flag, runs, where(some, 1.0, free * maximum(unlike, _stands_near(flag, rate))), period[0]
        )
        pushed = flag > 1.0
        share = where(pushed, 1.0, share)
        held = where(pushed, np.inf, distance * share), where(share < 1.0, np.inf, period[0] * own[0])
        place, faster, clipped = _followed((goal, rate), seen, (place, speed), step, period[0], held, own)
        slow = TOUCH * share * own[0]
        faster = where(share < 1.0, clip(faster, -slow, slow), faster)
        lag, ahead = place - goal, faster - rate
        slow = where(absolute(ahead) > 2.0 * period[0] * own[1], 0.0, 1.0)
        flag = where(pushed, flag, where(absolute(lag) > OVER * distance, flag, flag * (1.0 - slow)))
        flag = maximum(flag, is_far)
        lag, ahead = where(flag > 0.5, lag, 0.0), where(flag > 0.5, ahead, 0.0)
        shifts = dict(zip(row, (lag, ahead, lag, ahead)))
        for motors, factors in zip(places, turned):  # of coupled joints, T times that
            factor = factors[len(flags)]
            shifts |= {motors[2]: factor * lag, motors[3]: factor * ahead} if factor else {}
        for each, shift in shifts.items():
            command[each] = command[each] + shift
        back = where(pushed, 0.0, where(flag > 0.5, 1.0, 0.0))
        flags.append(flag)
        lags.append(where(clipped > 0.0, back * lag, 0.0))
        outrun.append(back * (estimate[turning] - command[turning]) / own[0])
        heard.append(1.0 if push is None else where(back > 0.5, clip(MOST - absolute(push), 0.0, 1.0), 1.0))
    return np.array(command), np.array(flags), np.array([lags, outrun, heard])


def _runs_away(lag: Any, speed: Any, commanded: Any, fast: Any) -> Any:
    """1 where a joint moves away from its command faster than that and a speed, else 0."""
    side = where(lag > 0.0, 1.0, -1.0)
    return where(side * speed - maximum(side * commanded, 0.0) > fast, 1.0, 0.0)


def _stands_near(flag: Any, rate: Any) -> Any:
    """1 of a joint that is not brought back, with a command that stands, else 0."""
    return where(flag > 0.5, 0.0, where(absolute(rate) > 0.0, 0.0, 1.0))


def _pushed(flag: Any, runs: Any, cause: Any, period: Any) -> Any:
    """The flag of a joint, 2 where it runs away for a cause, from which it falls to 1."""
    return where(runs * cause > 0.5, 2.0, where(flag > 1.0, maximum(flag - period / PUSHED, 1.0), flag))


def _followed(
    command: tuple[Any, Any], seen: Any, last: tuple[Any, Any], step: Any, period: Any, held: tuple[Any, Any],
    numbers: Sequence[Any],
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Position and speed of the motion that is shown of a joint, after those of the last sample, whose speed changes by
    a step at most, and by how much the joint, which is `seen`, keeps it back: to within a distance, by so much in a
    sample (2,)."""
    (goal, velocity), (before, speed), (distance, pulled) = command, last, held
    most, acceleration, lower, upper, rate = numbers
    lag = before - goal
    size = absolute(lag)
    back = minimum(minimum(0.5 * most, np.sqrt(acceleration * size + TINY)), rate * size)
    fastest = maximum(most, absolute(velocity))
    aim = clip(velocity - where(lag > 0.0, back, -back), -fastest, fastest)
    aim = clip(aim, speed - step, speed + step)
    free = clip(
        before + period * aim, minimum(lower, minimum(goal, before)), maximum(upper, maximum(goal, before))
    )
    place = clip(free, seen - distance, seen + distance)
    place = clip(place, minimum(free, before) - pulled, maximum(free, before) + pulled)
    kept = free - place
    # A joint that keeps the motion back stops it; one that is ahead of it does not make it faster.
    return place, where(kept * aim > 0.0, clip(0.0, speed - step, speed + step), aim), absolute(kept)


def believed(places: Sequence[Sequence[int]], share: Any, deviation: Any) -> np.ndarray:
    """The law's argument with a share (k,) of what is estimated of the velocities of links behind springs."""
    parts = list(deviation)
    for (link, turning, motor, _), part in zip(places, share):
        parts[turning] = parts[turning] if motor == link else part * parts[turning]
    return np.array(parts)


def unwound(error: Any, integral: Any, lag: Any) -> Any:
    """The errors (k,) that are integrated: those that take an integral back count from the command itself, of joints
    that are beyond what is shown of it."""
    rows = zip(error, integral, lag, strict=True)
    return np.array([where(e * i < 0.0, e + where(e * s > 0.0, s, 0.0), e) for e, i, s in rows])


def braked(integral: Any, faster: Any, period: Any) -> Any:
    """The integrals (k,) without what drives joints that are `faster` (k,) than is shown, in parts of the largest
    speed."""
    most = minimum(period[0] / TAKEN_BACK, 1.0)
    return np.array([
        i - where(i * v < 0.0, most * clip((absolute(v) - FASTER) / (MUCH_FASTER - FASTER), 0.0, 1.0) * i, 0.0)
        for i, v in zip(integral, faster, strict=True)
    ])  # fmt: skip
