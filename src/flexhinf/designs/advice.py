"""Changes that are tried where a design for a workspace misses a requirement, the cheapest for its user first.

Each is designed and judged again as the command that states it would do, so what is said of it holds for that command.
"""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.special import chdtri

from flexhinf.copies import cpu_seconds
from flexhinf.designs.fields import unchosen
from flexhinf.designs.judge import STANDSTILL_SHARE, missed_by
from flexhinf.designs.plans import UNLIMITED
from flexhinf.designs.requirements import REQUIREMENTS, Requirement
from flexhinf.designs.responses import joint_limits
from flexhinf.designs.specification import FIELDS, RINGS, Specification
from flexhinf.designs.workspace.design import MARGINS, design_workspace, judged_fields
from flexhinf.designs.workspace.evidence import WorkspaceEvidence
from flexhinf.designs.workspace.search import TOLERATED, motors_alone
from flexhinf.errors import FlexhinfError
from flexhinf.numerals import count_text
from flexhinf.options import with_value
from flexhinf.plant.instruments import SENSORS
from flexhinf.processors import single_blas
from flexhinf.robot import Robot
from flexhinf.robot.modes import modes_of, stiffness_and_inertia
from flexhinf.robot.signals import expanded, units_of

#: A limit of moves is offered with room for this share of all moves, so that 40 later ones keep it, nine times of ten.
#: One for 99 %, by 180 moves, was passed by 1 of 40 in another simulator and by 3 of 540 in this one. Confidence of the
#: mean tail; nine of ten limits have the share, as the median is estimated too.
QUANTILE, CONFIDENCE = 0.998, 0.95

#: A limit is offered that is at most so many times the present one, of the error at rest, and of that on the way, so
#: many; room of a limit of poses, of which there are enough for their worst.
WITHIN, REMAINING, ON_THE_WAY, ROOM = 3.0, 4.0, 10.0, 1.05

#: Least margins that are offered.
SMALLEST_MARGINS: dict[str, float] = dict(zip(MARGINS, (TOLERATED, 0.5)))

#: Limits of moves, by what `motion_metrics` calls their numbers.
OF_MOVES = {
    "remaining_error": "remaining_error",
    "tracking_error": "tracking_error",
    "path_distance": "path_distance",
    "undershoot": "wrong_way_percent",
}

#: Noise of positions, rms, where none is stated and ten times as much is assumed: a step of 2π/2¹⁸ has 7 µrad.
FINER, FINER_BITS = (
    {"rad": "0.01mrad", "m": "0.001mm"},
    "a tenth of the sensor noise that is assumed, as encoders of 18 bits have",
)

#: Part of the allowed time that the last step may take beyond it: limits that a change, once tried, would keep.
BEYOND = 0.5

#: So often limits are offered for one change.
ROUNDS = 3

#: Factors of the speed limits with which moves are tried, and of the period.
SLOWER, SHORTER = (0.5, 0.25), 0.5

#: Names of requirements on moves, which slower ones may keep.
MOVING = tuple(
    REQUIREMENTS[name].what
    for name in ("undershoot", "path", "at_limit", "speed", "range", "peak", "input_acceleration")
)


@dataclass(frozen=True)
class Change:
    """Fields of a specification that are stated otherwise, as texts of the command line, joints of the robot that are
    rigid, and what that is."""

    what: str
    fields: Mapping[str, str]
    rigid: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The options, ``--peak-speed 0.5``, and what the robot's file says."""
        joints = [f"rigid = true for {', '.join(self.rigid)}"] * bool(self.rigid)
        return " ".join(
            [*joints, *(with_value(FIELDS[name].option, value) for name, value in self.fields.items())]
        )

    @property
    def is_limit(self) -> bool:
        """Whether it only states other limits."""
        return bool(self.fields) and {*self.fields} <= {*judged_fields(), *MARGINS}

    def to(self, s: Specification) -> Specification:
        """A specification with the change."""
        return replace(s, **dict[str, Any](self.fields))


@dataclass(frozen=True)
class Trial:
    """What came of a change: all requirements, or those up to the first that no limit can keep."""

    change: Change
    requirements: tuple[Requirement, ...]
    whole: bool  # whether all requirements were judged
    refused: str = ""  # why there is no design with the change

    @property
    def met(self) -> bool:
        """Whether all requirements are met."""
        return self.whole and all(line.met for line in self.requirements)

    @property
    def missed(self) -> tuple[Requirement, ...]:
        """Requirements that are not met."""
        return tuple(line for line in self.requirements if line.missed)

    @property
    def distance(self) -> tuple[bool, float, int]:
        """How far it misses, for comparisons: whether it was judged to its end, the worst ratio, how many lines."""
        return not self.whole, max(map(missed_by, self.missed), default=math.inf), len(self.missed)


@dataclass(frozen=True)
class Advice:
    """What was tried after a design that misses a requirement."""

    trials: tuple[Trial, ...]
    left: tuple[Change, ...]  # for which there was no time
    seconds: float  # CPU time that was allowed
    command: tuple[str, ...] = field(default=())  # the command of the change that meets all; none in Python

    @property
    def found(self) -> Trial | None:
        """The change with which all requirements are met."""
        return next((trial for trial in self.trials if trial.met), None)

    @property
    def nearest(self) -> Trial | None:
        """The change that misses least, of those judged to their end; None without one."""
        tried = [trial for trial in self.trials if trial.whole]
        return min(tried, key=lambda trial: trial.distance, default=None)


class _Ended(Exception):
    """A trial ends early: a requirement is missed that no change of a limit keeps, or the time is spent."""

    def __init__(self, lines: Sequence[Requirement], spent: bool) -> None:
        super().__init__()
        self.lines, self.spent = tuple(lines), spent


@single_blas()
def advise(
    design: WorkspaceEvidence,
    seconds: float,
    progress: Callable[[str], None] = lambda text: None,
    joints: bool = True,
) -> Advice:
    """Try changes after a design that misses a requirement, until one meets all or the CPU time is spent.

    A limit of moves is offered with room for `QUANTILE` of them, see `with_room`.

    Parameters
    ----------
    design : WorkspaceEvidence
        The design; nothing is tried where it meets all requirements.
    seconds : float
        CPU time of the process that may be spent, s. Limits with which the design or a change would be kept are judged
        in half as much more, so that what nearly helps is not lost for want of them.
    progress : callable, optional
        Called with what comes next.
    joints : bool
        Whether joints may be made rigid, which is a change of the robot's file.
    """
    end, trials = cpu_seconds() + seconds, list[Trial]()
    waiting = [each for each in changes(design) if joints or not each.rigid] if design.missed else []

    def watch_until(limit: float, lines: Sequence[Requirement]) -> None:
        spent = cpu_seconds() > limit
        if spent or any(line.missed and not relaxable(line) for line in lines):
            raise _Ended(lines, spent)

    watch, finish = partial(watch_until, end), partial(watch_until, end + BEYOND * seconds)

    room = next((each for each in waiting if each.is_limit), None)
    # With other limits law and moves are mostly those of a design that is there, so these are tried at once. Margins
    # are searched for, which may take longer than a design with finer sensors, so that goes before them.
    sought = room is not None and bool({*room.fields} & {*MARGINS})
    left = sorted(
        waiting, key=lambda each: each is not room and not (sought and "measurement_noise" in each.fields)
    )
    kept: Trial | None = None  # named where nothing meets all that costs less
    while left and cpu_seconds() <= end:
        change = left[0]
        trial, other = _tried(design, change, progress, finish if change is room else watch)
        if trial is None:  # no time for it
            break
        del left[0]
        if room is not None and change is room and trial.met:
            kept, left = trial, [each for each in left if each in waiting[: waiting.index(room)]]
            continue
        trials.append(trial)
        if trial.met:
            left.clear()
        elif kept is None and other is not None:
            kept = _with_limits(change, other, progress, finish)
    if kept is not None and not any(trial.met for trial in trials):
        trials.append(kept)
    return Advice(tuple(trials), tuple(left), seconds)


def _with_limits(
    change: Change, other: WorkspaceEvidence | None, progress: Callable[[str], None], watch: Any
) -> Trial | None:
    """The trial of a change together with limits that its design would keep; None where that misses something.

    With a looser limit the search finds another law, which uses it; so limits are offered until one is kept.
    """
    fields = dict(change.fields)
    for _ in range(ROUNDS):
        limits = None if other is None else limit_change(other, margins=False)
        if other is None or limits is None:
            return None
        fields |= limits.fields
        trial, other = _tried(other, limits, progress, watch)
        if trial is not None and trial.met:
            what = "; ".join(dict.fromkeys((change.what, limits.what)))
            return replace(trial, change=Change(what, fields, change.rigid))
    return None


def _tried(
    design: WorkspaceEvidence, change: Change, progress: Callable[[str], None], watch: Any
) -> tuple[Trial | None, WorkspaceEvidence | None]:
    """A change tried, and its design if that was judged to its end; no trial where its time was spent before."""
    robot = design.robot.with_rigid(*change.rigid) if change.rigid else design.robot
    try:
        other = design_workspace(  # as by the command
            robot,
            change.to(unchosen(design.robot, design.specification)),
            lambda text: progress(f"try {change.text}: {text}"),
            watch,
            None if change.rigid else design,
            change.fields,
        )
    except _Ended as ended:
        return (None if ended.spent else Trial(change, ended.lines, whole=False)), None
    except FlexhinfError as error:
        return Trial(change, (), whole=False, refused=error.what), None
    return Trial(change, other.requirements, whole=True), other


# What may be changed ------------------------------------------------------------------------------------
def changes(design: WorkspaceEvidence) -> Iterator[Change]:
    """Changes that may help against what is missed, in the order of what they cost: nothing, a number that was assumed,
    slower moves, a faster computer, less accuracy, more encoders."""
    s, missed = design.specification, design.missed
    looped = any(line.what not in MOVING and line.field not in OF_MOVES for line in missed)
    if looped and (rigid := unseen(design.robot, s.period)):
        yield Change("joints whose vibration is faster than samples show", {}, rigid)
    heard = looped or any(line.field in OF_MOVES for line in missed)
    assumed = s.estimator != "none" and s.measurement_noise is FIELDS["measurement_noise"].default
    if heard and assumed and (finer := finer_noise(design)):
        yield Change(f"{FINER_BITS}, if the sensors are so", {"measurement_noise": finer})
    moving = any(line.what in MOVING or line.field == "path_distance" for line in missed)
    if moving:
        yield slower_moves(design, SLOWER[0])
    if looped and (shorter := SHORTER * s.period) >= design.robot.drive_period:
        yield Change("a shorter period", {"period": f"{1e3 * shorter:g}ms"})
    if (room := limit_change(design)) is not None:
        yield room
    if moving:
        yield from (slower_moves(design, factor) for factor in SLOWER[1:])
    if motors_alone(design.robot, s) or [*s.measured] == ["link_position"]:
        alike = not any(isinstance(value, tuple) for value in (s.measurement_noise, s.quantisation))
        if alike and s.estimator != "none":
            yield Change("encoders on links and motors", {"measured": "link_position,motor_position"})


def finer_noise(design: WorkspaceEvidence) -> str:
    """A tenth of the assumed noise of all sensors, as text; "" where not all of them are positions."""
    units = units_of(design.robot.joint_names, design.robot.links.slides)
    signals = expanded(design.specification.measured, SENSORS, design.robot.joint_names, design.robot.rigid)
    each = [FINER.get(units[name], "") for name in signals]
    return "" if "" in each else each[0] if len(set(each)) == 1 else ",".join(each)


def unseen(robot: Robot, period: float) -> tuple[str, ...]:
    """Joints that vibrate, at home, faster than samples of a period, s, show (Nyquist), the fastest first; one joint
    stays elastic."""
    found = list[str]()
    while len(robot.joint_names) - len(robot.rigid) > 1:
        plant, at = robot.plant(), robot.operating_point()
        modes = modes_of(plant.linearise(*at)[0], robot.joint_names, *stiffness_and_inertia(plant, at))
        vibrations = [mode for mode in modes if mode.vibration]
        if not vibrations or abs(vibrations[-1].eigenvalue) <= math.pi / period or robot.coupling:
            break  # no joint that shares a motor may be rigid
        found.append(vibrations[-1].joint)
        robot = robot.with_rigid(vibrations[-1].joint)
    return tuple(found)


def slower_moves(design: WorkspaceEvidence, factor: float) -> Change:
    """Smaller speed limits; moves are planned with a share of these."""
    speed = joint_limits(design.robot, design.specification).speed
    speeds = [f"{factor * each:.3g}" for each in np.where(np.isfinite(speed), speed, UNLIMITED).tolist()]
    return Change("slower moves", {"peak_speed": speeds[0] if len({*speeds}) == 1 else ",".join(speeds)})


def relaxable(line: Requirement) -> bool:
    """Whether a missed requirement may be kept by another limit, at most `WITHIN` times this one."""
    by_margin = line.field in MARGINS  # poses are counted; the margins say how far
    near = line.field in (*OF_MOVES, "ripple") and line.found <= _within(line.field) * line.limit
    return bool(by_margin or near or (line.field == "damping" and line.found > RINGS))


def _within(name: str) -> float:
    return {"tracking_error": ON_THE_WAY, "remaining_error": REMAINING}.get(name, WITHIN)


def limit_change(design: WorkspaceEvidence, margins: bool = True) -> Change | None:
    """Limits with room with which the design, as it is, misses nothing; None where they are not enough.

    `margins`: of gain and delay too, whose search takes as long as a third of a design where it was not made before.
    """
    values = {line.field: "" for line in design.missed if relaxable(line)}
    if not values or not all(map(relaxable, design.missed)) or (not margins and {*values} & {*MARGINS}):
        return None
    values = {name: _looser(design, name) for name in values}
    if not all(values.values()):
        return None
    moves, origin = len(design.sampled or design.moves), list[str]()
    if {*values} & {*OF_MOVES}:
        origin.append(f"for {100.0 * QUANTILE:g} % of all moves, by {moves} of them")
    if {*values} - {*OF_MOVES}:
        origin.append(f"with room for what was found at {count_text(len(design.loops), 'pose')}")
    return Change(f"{'a limit' if len(values) == 1 else 'limits'} {' and '.join(origin)}", values)


def _looser(design: WorkspaceEvidence, name: str) -> str:
    """A limit with room, as text; "" where it would be too far from the present one."""
    lines = [line for line in design.missed if line.field == name]
    if name in OF_MOVES:
        return _of_moves(design, name, lines)
    if name == "ripple":
        value = ROOM * max(line.found for line in lines)
        return f"{_up(value):g}" if value <= WITHIN * lines[0].limit else ""
    if name == "damping":
        value, least = min(line.found for line in lines), RINGS
    else:
        margin = design.robustness
        tolerated = {"gain_margin": min(margin.louder, 1.0 / margin.softer), "delay_margin": margin.delay}
        value, least = tolerated[name], SMALLEST_MARGINS[name]
    value = math.floor(100.0 * value / ROOM) / 100.0
    return f"{value:g}" if value >= least else ""


def _of_moves(design: WorkspaceEvidence, name: str, lines: Sequence[Requirement]) -> str:
    """A limit of moves with room for `QUANTILE` of those of robots at corners, where there are any, that no other move
    passes; one that each joint has of its own is kept in proportion."""
    stated = getattr(design.specification, name)
    own = np.atleast_1d(np.array(stated if stated is not None else lines[0].limit, dtype=float))
    several = len(own) > 1
    scale = own if several else np.ones(1)
    rows = [move.motion for move in (*design.moves, *design.sampled)]
    values = [
        float(np.max(np.array([joint[OF_MOVES[name]] for joint in row]) / scale)) if row else math.inf
        for row in rows
    ]
    worst = max(values)
    value = max(with_room(values[len(design.moves) :] or values), worst)
    for line in lines:
        if line.what == REQUIREMENTS["limit_cycle"].what:  # a share of this limit, seen in one move
            cycle = line.found / STANDSTILL_SHARE / (own.min() if several else 1.0)
            value = max(value, cycle * max(value / worst, ROOM))
    if not value <= _within(name) * (1.0 if several else float(own[0])):
        return ""
    return ",".join(f"{_up(value * each):g}" for each in scale.tolist())


def with_room(values: Sequence[float]) -> float:
    """What at most a share `1 - QUANTILE` of all moves passes, by those that were made; in nine of ten cases.

    The larger half of the values lies beyond their median as exponential numbers do (tails of moves by a law that is
    stable are not longer), whose mean has a χ² bound; never less than the largest value. No rule without a tail has an
    answer: 180 values alone tell the share of 98.7 %.
    """
    middle = float(np.median(values))
    beyond = [value - middle for value in values if value > middle]
    if not beyond or not math.isfinite(max(values)):
        return max(values)
    mean = 2.0 * sum(beyond) / float(chdtri(2 * len(beyond), CONFIDENCE))
    return max(max(values), middle + mean * math.log(0.5 / (1.0 - QUANTILE)))


def _up(value: float) -> float:
    """The number with two digits that is not less."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1.0)
    return float(f"{math.ceil(value / unit * (1.0 - 1e-9)) * unit:.2g}")
