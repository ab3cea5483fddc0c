"""What a controller says of its own state after a step, and how it reacts: plain functions with counters for memory.

Four things are watched (`Supervision`), at a fixed number of operations and five numbers of memory for each input and
tracked position:

- A command *outside the workspace*, a box of the commanded positions. The box is a statement of the design.
- A *limit cycle*: some input swings to and fro while the command rests. A swing ends where the input has come back by
  more than `swing` from its last extreme, so noise and small ripple make none. It is a limit cycle when more swings
  follow each other, each within `longest_swing`, than a linear loop can make whose oscillations are damped by at least
  `damping`: its swings shrink by exp(−πζ/√(1 − ζ²)) each, and an input within its limits starts with at most the whole
  range, so ln(range/swing) √(1 − ζ²)/(πζ) of them are larger than `swing`. A tracked position is watched likewise
  where `position_swing` is stated; it has no range, and begins with at most `UNLIMITED` times that.
- *Saturation that lasts*: an input has been at 99.9 % of a limit for longer than `saturation_time`.
- A *following error*: a tracked position is farther than `following` from the command of its instant. So are joints
  that something blocks, motors without power, and a robot that does not stand where the controller begins: what counts
  is the measurement itself, without the offset that `offset_time` takes in slowly.
- A *blocked* joint, where a governor states a resistance: something keeps it from its command by more than the model
  and its tolerances explain, and it lets go, see `flexhinf.loop.controller.governor`.

Whether the *estimate is in doubt* is said without a supervision too, of estimators that know it: at this sample
rounding may move the estimate by more than a thousandth of its standard deviation, or a covariance had to be repaired,
see `flexhinf.estimation.diagnosis`. A measurement that a gate rejects is another thing, and has a count of its own.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Number, Numbers
from flexhinf.codegen import gives
from flexhinf.errors import refuse_if
from flexhinf.loop.controller.options import Limits
from flexhinf.loop.controller.signs import Watch
from flexhinf.loop.shared import BRAKING
from flexhinf.notebook import StatedRepr
from flexhinf.numerals import number, number_text
from flexhinf.scalars import absolute, clip, maximum, minimum, where
from flexhinf.validation import checked_kind, checked_positive, one_of, real_array, real_number, value_text


class Status(enum.IntFlag):
    """What a controller says after a step, in the order of its bits; the exported C has the same number.

    Examples
    --------
    >>> import flexhinf as fh
    >>> status = fh.Status.SATURATION | fh.Status.REACTING
    >>> fh.Status.SATURATION in status
    True
    >>> print(status)
    SATURATION, REACTING
    """

    OUTSIDE_WORKSPACE = 1
    LIMIT_CYCLE = 2
    SATURATION = 4
    REACTING = 8
    DOUBTFUL_ESTIMATE = 16
    FOLLOWING_ERROR = 32
    BLOCKED = 64
    REPEATED_FRAME = 128
    SENSOR_LOST = 256
    INCONSISTENT = 512
    RUNNING_AWAY = 1024
    TOO_FAST = 2048
    OPPOSED = 4096
    OSCILLATING = 8192
    STUCK = 16384

    def __str__(self) -> str:
        """Names of the bits that are set; `format` and the exported C have the number."""
        return ", ".join(str(bit.name) for bit in Status if bit in self) or "nothing to report"


#: The bits of what is watched, in the order of their flags in the memory.
WATCHED = (
    Status.OUTSIDE_WORKSPACE,
    Status.LIMIT_CYCLE,
    Status.SATURATION,
    Status.REACTING,
    Status.FOLLOWING_ERROR,
    Status.BLOCKED,
    Status.REPEATED_FRAME,
    Status.SENSOR_LOST,
    Status.INCONSISTENT,
    Status.RUNNING_AWAY,
    Status.TOO_FAST,
    Status.OPPOSED,
    Status.OSCILLATING,
    Status.STUCK,
)

#: How many of them a supervision watches; the others are those of a protection.
SUPERVISED = 6

#: What can be reacted to, in the order of the flags, and how: about a standing command, and about a moving reference.
REACTIONS = {
    "workspace": (("none", "hold", "limit", "brake"), ("none", "brake")),
    "limit_cycle": (("none", "hold"), ("none",)),
    "saturation": (("none", "hold", "brake"), ("none", "brake")),
    "following": (("none", "hold", "brake"), ("none", "hold", "brake")),
    "blocked": (("none", "brake"), ("none", "brake")),
}

#: An end of a workspace nearer to 0 than this share of its width is written as 0.
HIDDEN = 1e-4

#: Fraction of half of an input's range that counts as its limit; the range over a swing where there is no limit.
NEAR_LIMIT, UNLIMITED = 1e-3, 100.0


@dataclass(frozen=True, eq=False, repr=False)
class Supervision(StatedRepr):
    """What a controller watches at run time, and how it reacts.

    Parameters
    ----------
    workspace : tuple (lower, upper), optional
        The commanded positions for which the controller is designed, numbers or (k,); None: not stated.
    swing : float or (m,), optional
        Smallest swing of an input that counts, peak to peak; by default a tenth of its range (± 10 % of its limit), and
        an input without limits is not watched.
    position_swing : float or (k,), optional
        Smallest swing of a tracked position that counts, peak to peak, rad or m; None: positions are not watched.
    damping : float
        Least damping ratio of oscillations that count as settling: sets how many swings make a limit cycle.
    longest_swing : float
        s; half a period of the slowest oscillation that is noticed.
    saturation_time : float
        s.
    following : float or (k,), optional
        Largest distance of a tracked position from its command, rad or m; None: it is not watched. A command that jumps
        by more exceeds it.
    reactions : mapping
        Of "workspace", "limit_cycle", "saturation", "following" and "blocked" to "none" (the default), "hold", "limit"
        or "brake".
        "hold": the last command inside the workspace stays; at another event the command becomes the position at that
        sample, until `Controller.reset`. At a following error the input goes on without a jump: what the law then asks
        for less decays with `braking_time`; and a moving reference becomes the estimated state there without its
        velocities, with the input that it had. "limit": the command is moved to the nearest one in the box.
        "brake": `Controller.path_rate` falls from 1 to 0, until `Controller.reset`, and whoever makes the command
        advances its time along the path by that fraction of a period. A command that is outside of the workspace from
        the first sample on may come back. A moving reference is else braked only, as it has
        velocities; a limit cycle is noticed at a command that rests, where there is nothing to brake.
    braking_time : float
        s; from the path rate 1 to 0.

    Raises
    ------
    InvalidInput
        If numbers are not positive, or names or reactions are none.

    Examples
    --------
    A command outside of ±1 rad is not followed:

    >>> import flexhinf as fh
    >>> import numpy as np
    >>> arm = fh.paper_arm()
    >>> watch = fh.Supervision((-1.0, 1.0), reactions={"workspace": "hold"})
    >>> controller = fh.Controller(fh.linear_law(arm.problem(), np.inf), None, 1e-3, supervision=watch)
    >>> u = controller.step(np.zeros(4), [2.0])
    >>> fh.Status.OUTSIDE_WORKSPACE in controller.status
    True
    """

    workspace: tuple[ArrayLike, ArrayLike] | None = None
    swing: Numbers = None
    damping: float = 0.05
    longest_swing: float = math.pi / 2.0
    saturation_time: float = 0.2
    reactions: Mapping[str, str] = field(default_factory=dict[str, str])
    braking_time: float = 0.3
    position_swing: Numbers = None
    following: Numbers = None

    def __post_init__(self) -> None:
        for name in ("damping", "longest_swing", "saturation_time", "braking_time"):
            unit = "a ratio" if name == "damping" else "seconds"
            checked_positive(f"The {name} of a supervision", getattr(self, name), unit, f"{name}=0.2")
        refuse_if(
            real_number(self.damping) >= 1.0,
            "The damping of a supervision is no damping ratio.",
            f"expected 0 < number < 1, got {value_text(self.damping)}",
            "damping=0.05",
        )
        pair = isinstance(self.workspace, (tuple, list)) and len(self.workspace) == 2
        refuse_if(
            self.workspace is not None and not pair,
            "The workspace is no box.",
            f"expected (lower, upper), got {value_text(self.workspace)}",
            "workspace=(-1.0, 1.0)",
        )
        what, advice = "The reactions are no mapping.", "reactions={'workspace': 'limit'}"
        checked_kind(what, self.reactions, Mapping, "reactions by event", advice)
        for event, reaction in dict(self.reactions).items():
            one_of("There is nothing of this name to react to.", event, REACTIONS)
            one_of(f"There is no such reaction to {event!r}.", reaction, REACTIONS[event][0])

    def settings(self) -> dict[str, object]:
        """Arguments as numbers, lists and texts, for a file."""
        box = None if self.workspace is None else [real_array(end).tolist() for end in self.workspace]
        sizes = {
            name: None if (size := getattr(self, name)) is None else real_array(size).tolist()
            for name in ("swing", "position_swing", "following")
        }
        return {**asdict(self), "workspace": box, **sizes, "reactions": dict(self.reactions)}

    def box_text(self, units: Sequence[str], factor: Number = 1.0) -> str:
        """The workspace, for a summary; the commanded positions (k,), times a factor, are in these `units`."""
        if self.workspace is None:
            return "not stated"
        low, high = (factor * _spread(end, len(units)) for end in self.workspace)
        width = np.where(np.isfinite(high - low), high - low, 0.0)
        ends = [np.where(np.abs(end) < HIDDEN * width, 0.0, end).tolist() for end in (low, high)]
        return ", ".join(f"{number(a)} to {number_text(b, unit)}" for a, b, unit in zip(*ends, units))

    def reactions_text(self, units: Sequence[str], factor: Number = 1.0) -> str:
        """The reactions, for a summary; the commanded positions (k,), times a factor, are in these `units`."""
        sizes = (factor * _spread(np.inf if self.following is None else self.following, len(units))).tolist()
        beyond = " or ".join(dict.fromkeys(number_text(size, unit, 3) for size, unit in zip(sizes, units)))
        events = {
            "workspace": "a command leaves the workspace",
            "limit_cycle": "a signal swings to and fro at rest",
            "saturation": f"an input is at a limit for {self.saturation_time:g} s",
            "following": f"a position is beyond {beyond} from its command",
            "blocked": "something blocks a joint",
        }
        return ", ".join(f"{kind} where {events[e]}" for e, kind in self.reactions.items() if kind != "none")

    def modes(self, moving: bool, governor: object = None) -> tuple[str, ...]:
        """The reaction to each of `REACTIONS`; one that a moving reference (or a standing command) cannot have is
        refused, or to what no `Governor` notices."""
        modes = tuple(self.reactions.get(event, "none") for event in REACTIONS)
        for (event, possible), reaction in zip(REACTIONS.items(), modes):
            refuse_if(
                reaction not in possible[moving],
                f"A moving reference cannot react so to {event!r}.",
                f"expected one of {list(possible[moving])} with moving=True, got {reaction!r}",
                "'brake': a reference that moves can only be slowed to rest along its path",
            )
        refuse_if(
            modes[0] != "none" and self.workspace is None,
            "A reaction is stated to leaving a workspace that is not.",
            f"expected a workspace with the reaction {modes[0]!r}, got None",
            "workspace=(lower, upper)",
        )
        refuse_if(
            modes[3] != "none" and self.following is None,
            "A reaction is stated to a following error without a limit.",
            f"expected following=… with the reaction {modes[3]!r}, got None",
            "following=0.3",
        )
        refuse_if(
            modes[4] != "none" and getattr(governor, "resistance", None) is None,
            "A reaction is stated to a joint that is blocked, which nothing notices.",
            f"expected a governor with a resistance for the reaction {modes[4]!r}, got {value_text(governor)}",
            "governor=Governor(…, resistance=…), or reactions without 'blocked'",
        )
        return modes

    def data(self, limits: Limits, commanded: int, period: float) -> dict[str, ArrayLike]:
        """Numbers of the step for inputs within `Limits`, and so many commanded positions."""
        ends: Any = (-np.inf, np.inf) if self.workspace is None else self.workspace
        span = np.append(limits.upper - limits.lower, np.full(commanded, np.inf))
        low, high = box = np.array([_spread(end, commanded) for end in ends])
        inputs = len(span) - commanded
        swing = _spread(0.1 * span[:inputs] if self.swing is None else self.swing, inputs)
        position_swing, following = (
            _spread(np.inf if size is None else size, commanded)
            for size in (self.position_swing, self.following)
        )
        refuse_if(
            not np.all(low < high) or (self.workspace is not None and not commanded),
            "The workspace does not fit the command.",
            f"expected lower < upper for {commanded} positions, got {value_text(self.workspace)}",
            "workspace=(lower, upper), a number or one per commanded position; None where nothing is commanded",
        )
        refuse_if(
            not np.all(swing > 0.0),
            "The swing of a supervision is not positive.",
            f"expected numbers > 0, one or {inputs}, got {value_text(self.swing)}",
            "swing=None: a tenth of the range",
        )
        for name, sizes in (("position_swing", position_swing), ("following", following)):
            stated = getattr(self, name)
            refuse_if(
                not np.all(sizes > 0.0) or (stated is not None and not commanded),
                f"The limit {name!r} of a supervision does not fit the tracked positions.",
                f"expected numbers > 0, one or {commanded}, got {value_text(stated)}",
                f"{name}=None: it is not watched",
            )
        swing = np.append(swing, position_swing)
        shrinking = math.pi * self.damping / math.sqrt(1.0 - self.damping**2)
        ratio = np.where(np.isfinite(span), span, UNLIMITED * swing) / np.where(
            np.isfinite(swing), swing, 1.0
        )
        swings = 1.0 + np.ceil(np.log(np.maximum(ratio, 1.0)) / shrinking)
        swings = np.where(np.isfinite(swing), swings, np.inf)
        edge = np.where(np.isfinite(span), 0.5 * NEAR_LIMIT * span, 0.0)
        braking = period / self.braking_time
        samples = [self.longest_swing / period, self.saturation_time / period, braking, math.exp(-braking)]
        table = np.array([edge, swing, swings])
        return {"workspace": box, "swings": table, "watching": samples, "following": following}


def possible_status(
    supervision: Supervision | None, watched: Mapping[str, Any], limits: Any, doubts: bool, mode: Any
) -> Status:
    """The bits that a controller of a mode can set; the others are always 0.

    `watched`: as of `watched_numbers`, for inputs within `limits`; `doubts`: whether its estimator knows doubt.
    """
    able = Status.DOUBTFUL_ESTIMATE if doubts else Status(0)
    if supervision is None:
        return able
    bits = {
        "workspace": (Status.OUTSIDE_WORKSPACE, supervision.workspace is not None),
        "limit_cycle": (Status.LIMIT_CYCLE, np.isfinite(watched["swings"][2]).any()),
        "saturation": (Status.SATURATION, np.isfinite([limits.lower, limits.upper]).any()),
        "following": (Status.FOLLOWING_ERROR, np.isfinite(watched["following"]).any()),
        "blocked": (Status.BLOCKED, bool(mode.resisted)),
    }
    able |= Status.REACTING if mode.governed else Status(0)
    able |= possible_signs(mode.protected) if mode.protected else Status(0)
    for event, (bit, possible) in bits.items():
        if possible:
            reacts = supervision.reactions.get(event, "none") != "none"
            able |= bit | (Status.REACTING if reacts else Status(0))
    return able


def possible_signs(watch: Watch) -> Status:
    """The bits that a protection can set."""
    always = Status.REPEATED_FRAME | Status.SENSOR_LOST | Status.RUNNING_AWAY | Status.TOO_FAST
    always |= Status.OPPOSED | Status.OSCILLATING
    inconsistent = Status.INCONSISTENT if watch.pairs else Status(0)
    return always | inconsistent | (Status.STUCK if watch.alone else Status(0))


def watched_numbers(
    supervision: Supervision | None, limits: Any, commanded: int, period: float
) -> dict[str, Any]:
    """`Supervision.data`, checked; nothing without a supervision."""
    what, advice = "The supervision of a controller is none.", "Supervision(workspace=(lower, upper))"
    checked_kind(what, supervision, Supervision | None, "a Supervision or None", advice)
    return {} if supervision is None else supervision.data(limits, commanded, period)


def _spread(value: Any, size: int) -> np.ndarray:
    array = real_array(value)
    return np.broadcast_to(array if array.shape in ((), (size,)) else np.nan, (size,))


def first_counters(
    inputs: int, tracked: int, reactions: tuple[str, ...], protected: bool
) -> dict[str, np.ndarray]:
    """Parts of the memory before the first sample, which itself counts no swing."""
    if not reactions:
        return {}
    signals = np.ones(inputs + tracked)
    counters = {
        "watch": np.outer([0.0, 1.0, 0.0, 0.0, 0.0], signals),
        "status": np.zeros(len(WATCHED) if protected else SUPERVISED),
    }
    counters |= {} if set(reactions) == {"none"} else {"stop": np.array([0.0, 0.0, 1.0])}
    return counters | ({"ease": np.zeros(inputs)} if eases(reactions) else {})


def eases(reactions: tuple[str, ...]) -> bool:
    """Whether some reaction holds the robot without a jump of the input."""
    return reactions[3:4] == ("hold",)


def _any(flags: Sequence[Any]) -> Any:
    """1 where some flag is, of flags that are 0 or 1: of one flag it decides nothing."""
    return reduce(lambda found, flag: where(found > 0.0, found, flag), flags) if len(flags) else 0.0


def _outside(positions: Any, box: Any) -> Any:
    return _any([where(p < a, 1.0, where(p > b, 1.0, 0.0)) for p, a, b in zip(positions, *box)])


@gives("commanded", "stop_next")
def reaction(
    places: Sequence[int],
    reactions: tuple[str, ...],
    r: Any,
    last: Any,
    position: Any,
    started: Any,
    status: Any,
    stop: Any,
    box: Any,
    watching: Any,
) -> tuple[Any, Any]:
    """The command (k,) after the reactions, and the state of the stop (3,): whether the command is frozen, the fraction
    of the braking that is done, and the path rate.

    `last` (k,) is the command on which the law acted, `position` (k,) the one that rests where the joints are, `status`
    (6,) that after the last sample; of a moving reference, r is what it is, and its positions are at `places`.
    """
    positions = [r[place] for place in places]
    events = (*status[1:3], *status[4:])
    beyond = [_outside(positions, box), *events]
    leaving = where(started[0] > 0.5, beyond[0] - status[0], 0.0)
    frozen, braked, _ = stop
    freezing = _any([flag for flag, kind in zip(beyond[1:], reactions[1:]) if kind == "hold"])
    slowing = zip((leaving, *events), reactions)
    braking = _any([braked, *(flag for flag, kind in slowing if kind == "brake")])
    braked = where(braking > 0.0, minimum(braked + watching[2], 1.0), 0.0)
    slope = [k * c for k, c in enumerate(BRAKING)][:0:-1]
    rate = reduce(lambda total, c: total * braked + c, slope)
    if reactions[0] == "limit":
        r = clip(r, *box)
    if "hold" in reactions:
        last = where(started[0] > 0.5, last, position)
        r = where(beyond[0], last, r) if reactions[0] == "hold" else r
        r = where(frozen, last, where(freezing, position, r))
    return r, np.array([maximum(frozen, freezing), braked, rate])


@gives("feedback_eased", "ease_next")
def eased(
    feedback: Any, operating: Any, last: Any, ease: Any, before: Any, now: Any, status: Any, watching: Any
) -> tuple[Any, Any]:
    """The feedback (m,) with what keeps the input continuous where a following error froze the command, and that (m,).

    `operating` is the input to which the feedback adds, `last` the input before; `before` and `now` (3,) are the states
    of the stop, `status` (6,) that after the last sample.
    """
    begins = status[4] * (now[0] - before[0]) > 0.5
    ease = where(begins, last - operating - feedback, watching[3] * ease)
    return feedback + ease, ease


@gives("watch_next", "status_next")
def observed(
    places: Sequence[int],
    reactions: tuple[str, ...],
    governs: int,
    u: Any,
    r: Any,
    last: Any,
    position: Any,
    wanted: Any,
    started: Any,
    watch: Any,
    lower: Any,
    upper: Any,
    box: Any,
    swings: Any,
    watching: Any,
    following: Any,
    *others: Any,
) -> tuple[Any, Any]:
    """Counters (5, m + k) and status (6,) after an input u (m,); `r` and `last` are this command and the one before.

    `position` (k,) is where the joints are, `wanted` the command that the law acts on for this instant. Counters of an
    input, and of a position: its last extreme, the direction since (±1), swings so far, samples since the last one
    ended, samples at a limit. The last of the arguments are, of a controller that `governs`, which joints are brought
    back (k,), and with two of them how these are held (4, k); and the state of the stop.
    """
    resting = where(absolute(np.asarray(r) - last).sum() > 0.0, 0.0, started[0])
    columns = list(zip(*swings, *watch))
    rows = [
        _counted(resting, watching[0], *ends, *column) for ends, column in zip(zip(u, lower, upper), columns)
    ]
    rows += [
        [*_swung(resting, watching[0], place, column[1], *column[3:7]), 0.0]
        for place, column in zip(position, columns[len(rows) :])
    ]
    apart = zip(position, [wanted[place] for place in places], following)
    lost = _any([where(absolute(is_at - goal) > limit, 1.0, 0.0) for is_at, goal, limit in apart])
    beyond = _outside([r[place] for place in places], box)
    cycles = _any([where(row[2] >= most, 1.0, 0.0) for row, most in zip(rows, swings[2])])
    full = _any([where(row[4] > watching[1], 1.0, 0.0) for row in rows])
    replaced, stop = [flag for part in others[: min(governs, 1)] for flag in part], others[governs:]
    blocked = _any([where(hold < 1.0, 1.0, 0.0) for part in others[1:governs] for hold in part[0]])
    replaced += [
        beyond if reactions[0] in ("hold", "limit") else 0.0,
        *(s for part in stop for s in part[:2]),
    ]
    reacting = where(_any(replaced) > 0.0, 1.0, 0.0)
    return np.array(rows).T, np.array([beyond, cycles, full, reacting, lost, blocked])


def _counted(
    resting: Any,
    longest: Any,
    u: Any,
    lower: Any,
    upper: Any,
    edge: Any,
    swing: Any,
    most: Any,
    extreme: Any,
    direction: Any,
    count: Any,
    since: Any,
    full: Any,
) -> list[Any]:
    at_limit = where(u >= upper - edge, full + 1.0, where(u <= lower + edge, full + 1.0, 0.0))
    return [*_swung(resting, longest, u, swing, extreme, direction, count, since), at_limit]


def _swung(
    resting: Any, longest: Any, u: Any, swing: Any, extreme: Any, direction: Any, count: Any, since: Any
) -> list[Any]:
    back = direction * (extreme - u)  # how far it has come back from the extreme
    turned = back > swing
    since = where(turned, 0.0, since + 1.0)
    return [
        where(turned, u, where(back < 0.0, u, extreme)),
        where(turned, -direction, direction),
        resting * where(turned, count + 1.0, where(since > longest, 0.0, count)),
        since,
    ]


def doubted(rcond: Any, least: Any, before: Any) -> Any:
    """Whether an estimate with a reciprocal condition (1,) is in doubt, and at how many samples one was (2,)."""
    flag = where(rcond[0] < least[0], 1.0, 0.0)
    return np.array([flag, before[1] + flag])


def status_of(watched: Any, doubt: Any) -> Status:
    """The status of numbers in the memory: the flags of what is watched, and whether the estimate is in doubt; either
    may be empty."""
    pairs = [*zip(WATCHED, watched), *zip([Status.DOUBTFUL_ESTIMATE], doubt)]
    return Status(sum(bit for bit, flag in pairs if flag > 0.5))
