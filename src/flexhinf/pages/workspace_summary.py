"""What a controller for a workspace was found to do, in words: its verdict, the worst numbers, and what was tried."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flexhinf.arrays import Number
from flexhinf.designs.advice import Advice, Trial
from flexhinf.designs.judge import UNHELD, missed_by
from flexhinf.designs.requirements import REQUIREMENTS, Requirement
from flexhinf.designs.responses import Move
from flexhinf.designs.specification import Specification
from flexhinf.designs.task import Task
from flexhinf.designs.verdict import estimated_text
from flexhinf.designs.workspace.evidence import WorkspaceEvidence
from flexhinf.designs.workspace.resting_loops import OFFSET
from flexhinf.designs.workspace.robustness import LATEST, LONGER, LOUDEST
from flexhinf.designs.workspace.search import GAMMA, motors_alone
from flexhinf.loop.simulation.metrics import peak_of
from flexhinf.numerals import count_text, number
from flexhinf.pages.drawing import Units, listed
from flexhinf.pages.page import controller_text, pose_task, requirement_table, requirements_text
from flexhinf.pages.settings import damping_text
from flexhinf.pages.terminal import (
    Ending,
    noise_text,
    numbers_text,
    requirements_screen,
    tolerances_text,
)
from flexhinf.pages.workspace_proof import proof_text
from flexhinf.report import Fact, Table
from flexhinf.robot import Robot
from flexhinf.robot.kinematics import heavy_motors
from flexhinf.robot.waypoints import LIMITS

#: Columns of the table of moves: key of `motion_metrics`, heading, unit; "" for that of small deviations.
COLUMNS = {
    "remaining_error": ("remaining error", ""),
    "tracking_error": ("tracking error", ""),
    "wrong_way_percent": ("motion the wrong way", "%"),
    "path_distance": ("distance from the path", ""),
    "ripple_percent": ("ripple of the motors", "%"),
}

#: Motion at power-on, or by offsets of the encoders, that a terminal names, rad or m.
FAR = 0.01

#: Samples of a plan by which its speed is found.
SPEED_SAMPLES = 201

#: A period that shows a vibration, in parts of a period of the vibration; half a period shows it barely.
PERIODS = 0.4
#: Changes without success that a terminal lists.
TRIED = 3

#: Fast vibrations with less damping are named beside the verdict.
HARDLY = 0.05


def units_in(design: WorkspaceEvidence) -> Units:
    """Units of the signals of a design, angles as the user gave them."""
    return Units(design.setup.model, design.setup.joints, design.specification.in_degrees)


def workspace_verdict(design: WorkspaceEvidence) -> str:
    """Whether the requirements are met, and by what."""
    missed = missed_text(design)
    return " ".join(
        filter(
            None,
            (
                preset_proof_text(design),
                f"Not met: {missed}." if missed else "Every requirement is met.",
                estimates_text(design.robot),
                scope_text(design),
            ),
        )
    )


def preset_proof_text(design: WorkspaceEvidence) -> str:
    """What is proved, where that was asked for, and how the law was chosen; "" otherwise."""
    if design.proof is None:
        return ""
    chosen = "No law of the search was proved for them, so this is the one that is found without the preset."
    if design.proof.is_stated:
        chosen = (
            "The law is the fastest found that keeps the limits at the poses of the search and is proved for this, "
            f"with γ = {design.setup.gains.weights.gamma:g} γ*, {gamma_source(design)}."
        )
    return f"{proof_text(design.proof)} {chosen}"


def gamma_source(design: WorkspaceEvidence) -> str:
    """Why the law has its γ."""
    if design.proof is None:
        return "ours"
    usual = design.setup.gains.weights.gamma == GAMMA
    return "the usual one" if usual else f"as no law of this bandwidth was proved with the usual {GAMMA:g}"


def estimates_text(robot: Robot) -> str:
    """That numbers of a robot are estimates, as a sentence; "" where none is."""
    text = estimated_text(robot)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def scope_text(design: WorkspaceEvidence) -> str:
    """What was judged, and what is hardly kept."""
    moves = motions_text(design)
    poses = f"at {poses_text(design)}" if design.setup.motion is None else "at rest there"
    each = "each with" if len(design.loops) > 1 or len(design.moves) > 1 else "both with"
    both = f", {each} your robot and with robots at the ends of their tolerances"
    if design.corner_loops and design.sampled:
        further = len(design.sampled) - len(design.moves)
        tested = f"{poses} and in {moves}{both}{f', and in {further} further ones of these' if further > 0 else ''}"
    else:
        tested = f"{poses}{f'{both},' if design.corner_loops else ''} and in {moves}"
    if any(move.plan.duration for move in design.moves):
        tested += f"; the fastest reached {speed_text(design)}: a larger speed_limit or --peak-speed tests faster ones"
    scope = f"{controller_text(design.specification, poses_of(design))}, tested {tested}."
    scope = f"{scope} {noise_text(design.setup)}".rstrip()
    if unheld := design.robustness.unheld:
        whose = ", with the largest masses of the tolerances" if design.robot.uncertain else ""
        scope += f" {unheld} of these poses need{'s' * (unheld == 1)} more than the motors have{whose}."
    fast = min(loop.fast_damping for loop in (*design.loops, *design.corner_loops))
    if 0.0 <= fast < HARDLY:  # below 0 a requirement is not met
        limit = f"{number(design.specification.damped_below_limit, 3)} rad/s"
        scope += f" Vibrations above {limit} are hardly damped (damping {number(fast, 2)})."
    return f"{scope} {nyquist_text(design)}".rstrip()


def poses_text(design: WorkspaceEvidence) -> str:
    """At which poses loops were judged."""
    return count_text(len(design.loops), "random pose") if design.setup.motion is None else "the pose"


def motions_text(design: WorkspaceEvidence) -> str:
    """Which motions were judged."""
    motion = design.setup.motion
    if motion is None:
        return count_text(len(design.moves), "move")
    return "the step to it" if motion.jumps else "the move to it"


def motions_title(design: WorkspaceEvidence) -> str:
    """Heading of what motions were judged."""
    if design.setup.motion is None:
        return f"{count_text(len(design.moves), 'move')} between random goals"
    return f"{motions_text(design)[4:].capitalize()}, {count_text(len(design.sampled) + 1, 'run')}"


def nyquist_text(design: WorkspaceEvidence) -> str:
    """The fastest vibration where it lies beyond half the sampling frequency, and a period whose samples show it."""
    (frequency, joint), period = design.robustness.fastest, design.specification.period
    if frequency <= 0.5 / period:
        return ""
    longest = 1e3 * PERIODS / frequency
    step = 10.0 ** (math.floor(math.log10(longest)) - 1)
    return (
        f"{joint} vibrates at {number(frequency, 3)} Hz, beyond half the sampling frequency, "
        f"{number(0.5 / period, 3)} Hz (Nyquist): samples do not show it, and no law damps it. "
        f"--period {math.floor(longest / step) * step:.2g}ms shows it."
    )


def speed_text(design: WorkspaceEvidence) -> str:
    """The largest planned speed of the moves, of joints that turn and of joints that slide."""
    largest: dict[str, float] = {}
    for plan in (move.plan for move in design.moves):
        if plan.duration == 0.0:  # a jump has no planned speed
            continue
        time = np.linspace(0.0, plan.duration, SPEED_SAMPLES)
        speeds = np.abs(np.gradient(np.reshape(plan(time), (SPEED_SAMPLES, -1)), time, axis=0)).max(axis=0)
        for speed, slides in zip(speeds.tolist(), design.robot.links.slides):
            unit = "m/s" if slides else "rad/s"
            largest[unit] = max(speed, largest.get(unit, 0.0))
    return " and ".join(f"{number(speed, 2)} {unit}" for unit, speed in largest.items())


def cause_text(design: WorkspaceEvidence) -> str:
    """What the largest remaining error comes from, and what lessens it, where more remains than is allowed."""
    cause, setup = design.remaining_cause, design.setup
    if cause is None:
        return ""
    units, joint = units_in(design), setup.joints[cause.joint]
    error, left = (units.small_text(size, 3, joint) for size in (cause.error, cause.without))
    if not cause.kind:
        return f"No tolerance, and neither dry friction nor a short rest, is by itself behind the {error} of {joint}."
    if cause.kind == "rest":
        if any(line.what == REQUIREMENTS["limit_cycle"].what for line in design.missed):
            return ""  # no rest is long enough for a limit cycle
        return f"The remaining error of {joint}, {error}, falls to {left} in a rest of {LONGER:g} s."
    name = f"the tolerance of the {cause.kind}" if cause.tolerance else cause.kind
    return f"The remaining error of {joint}, {error}, comes mostly from {name}: {left} without it."


def _cause_check(design: WorkspaceEvidence) -> str:
    """What to look at for the cause of the remaining error; "" where there is none that the robot's file states."""
    cause = design.remaining_cause
    if cause is None or cause.kind in ("", "rest"):
        return ""
    if cause.tolerance and cause.kind.startswith("payload"):
        return "the range of the payload (is it as wide?)"
    if cause.tolerance:
        return f"the tolerance of the {cause.kind}: a measured one may be narrower (flexhinf identify)"
    return "dry friction of the joints (coulomb_friction in the file: is it measured?)"


def vibration_text(design: WorkspaceEvidence) -> str:
    """The arm's own vibrations with held motors beside the bandwidth of the law."""
    gains, bandwidth = design.setup.pairs, design.setup.bandwidth
    followed = "" if bandwidth is None else f"the controller follows commands up to {bandwidth:.3g} rad/s."
    if gains is None:
        return followed[:1].upper() + followed[1:]
    low, high = (f"{float(end):.0f}" for end in np.sqrt(gains.ends))
    fastest = (
        "" if design.robot.rigid else f" to {high} (fastest)"
    )  # a rigid joint has a pair and no vibration
    seen = np.pi / design.specification.period
    hidden = f" Samples show no vibration beyond {seen:.0f} rad/s." if np.sqrt(gains.ends[1]) > seen else ""
    return f"The arm vibrates at {low} rad/s (slowest){fastest}; {followed}{hidden}"


def missed_text(design: WorkspaceEvidence) -> str:
    """The requirements that are not met, in one phrase each."""
    degrees = units_in(design).degrees
    return "; ".join(line.converted(degrees).text for line in design.missed)


def workspace_advice(design: WorkspaceEvidence, advice: Advice | None, most: int | None = None) -> str:
    """What was tried where a requirement is not met, and what to check in the robot's file; nothing otherwise.

    `most`: changes without success that are listed, the nearest first.
    """
    if not design.missed:
        return ""
    simpler = (
        "With motor encoders alone PD + gravity compensation is simpler and may do as well, see “Which law, and when” "
        "in the documentation."
    )
    without = (
        "These drives also follow without feedback: flexhinf export c ROBOT --feedforward --shaper, see “Drives” in "
        "the documentation."
    )
    alone = motors_alone(design.robot, design.specification)
    tried = "" if advice is None else tried_text(design, advice, most)
    if advice is not None and advice.found is not None:
        return tried
    return " ".join(
        filter(None, (tried, _to_check(design), simpler * alone, without * design.robot.drive_kind.inner))
    )


def tried_text(design: WorkspaceEvidence, advice: Advice, most: int | None = None) -> str:
    """The change that meets all, with the numbers of what was missed; or how far each came, the nearest first."""
    if (found := advice.found) is not None:
        what = {line.what for line in design.missed}
        lines = [line for line in found.requirements if line.what in what]
        return (
            f"Tried, and meets all {len(found.requirements)} requirements: {found.change.text} ({found.change.what})."
            f"{_numbers(design, lines)}"
        )
    trials = sorted(advice.trials, key=lambda trial: (bool(trial.refused), trial.distance))
    texts = [f"{trial.change.text} ({_misses(design, trial)})" for trial in trials[:most]]
    texts += [f"{len(trials) - len(texts)} more on the page"] * (len(trials) > len(texts))
    nearest = advice.nearest
    parts = [
        f"Tried without meeting all: {'; '.join(texts)}." if texts else "",
        f"{nearest.change.text} misses least." if nearest is not None and len(texts) > 1 else "",
        f"No CPU time was left, of {advice.seconds:.0f} s, for {listed([each.text for each in advice.left])}."
        if advice.left
        else "",
        "" if texts or advice.left else "No option is known that might help.",
    ]
    return " ".join(filter(None, parts))


def _numbers(design: WorkspaceEvidence, lines: Sequence[Requirement]) -> str:
    """What is achieved of some requirements, the worst of each kind; "" where none of them was judged."""
    worst = {line.what: line for line in sorted(lines, key=missed_by)}
    rows = [line.converted(units_in(design).degrees) for line in worst.values()]
    text = "; ".join(f"{line.what} {line.achieved_text}, required {line.limit_text}" for line in rows)
    return f" There: {text}." if text else ""


def _misses(design: WorkspaceEvidence, trial: Trial) -> str:
    """What a change misses most, and how much else."""
    if trial.refused:
        return f"refused: {trial.refused.rstrip('.')}"
    worst, *others = sorted(trial.missed, key=missed_by, reverse=True)
    line = worst.converted(units_in(design).degrees)
    kinds = len({each.what for each in others} - {line.what})
    return (
        f"{line.what} {line.achieved_text}, required {line.limit_text}{f', and {kinds} more' * bool(kinds)}"
        + "; given up then" * (not trial.whole)
    )


def _to_check(design: WorkspaceEvidence) -> str:
    """Numbers of the robot that decide what is missed, which only a look at the robot can improve."""
    missed, heavy = design.missed, heavy_motors(design.robot)
    full = any(line.what == REQUIREMENTS["at_limit"].what for line in missed)
    weak, cause = full or any(line.what == UNHELD for line in missed), _cause_check(design)
    explained = (
        REQUIREMENTS["remaining"].what if cause else ""
    )  # by its own cause; other lines by the tolerances
    known = design.remaining_cause is not None and design.remaining_cause.tolerance
    cornered = not known and any("corner" in line.where and line.what != explained for line in missed)
    texts = {
        cause: bool(cause),
        f"the inertia of the motor of {listed(heavy)} (is it in kg·m²?)": bool(heavy) and weak,
        "the limits of the motors (is effort_limit as seen from the link?)": weak,
        tolerances_text(design.robot): cornered,
    }
    chosen = [text for text, applies in texts.items() if applies]
    return f"To check: {'; '.join(chosen)}." if chosen else ""


def workspace_ending(design: WorkspaceEvidence, advice: Advice | None = None) -> Ending:
    """What a terminal says at the end: what is met, the worst numbers, what was tried and what to check."""
    worst = f"At worst: {numbers_text(key_numbers(design))}."
    parts = (
        preset_proof_text(design),
        f"{requirements_text(design.requirements)} {estimates_text(design.robot)} {scope_text(design)}",
        f"{worst} {vibration_text(design)}",
        cause_text(design),
        _starts(design),
        workspace_advice(design, advice, TRIED),
    )
    lines = requirements_with_margins(design)
    notes = [damping_text(design.robot), undamped_text(design)]
    return requirements_screen(lines, units_in(design).degrees, parts, notes)


def undamped_text(design: WorkspaceEvidence) -> str:
    """What is unstable where nothing damps the springs, which decides nothing."""
    cornered = "robots at corners of the tolerances"
    places = zip(design.undamped, (("the loop at the pose", "poses"), (f"one of the {cornered}", cornered)))
    counts = [
        _unstable_text(sum(loop.growth >= 1.0 for loop in loops), len(loops), *what)
        for loops, what in places
        if loops
    ]
    least = min(loop.fast_damping for loops in design.undamped for loop in loops)
    fast = f", damping of fast vibrations {number(least, 2)}" if least < 1.0 else ""
    return f"Without damping of the springs: {' and '.join(counts)}{fast} (decides nothing)."


def _unstable_text(count: int, of: int, one: str, several: str) -> str:
    """How many of some loops are unstable."""
    if of == 1:
        return f"{one} is {'unstable' if count else 'stable'}"
    return f"{count or 'none'} of {of} {several} {'is' if count < 2 else 'are'} unstable"


def every_requirement(design: WorkspaceEvidence) -> Table:
    """All requirements, met or not, for a terminal."""
    lines = requirements_with_margins(design)
    return requirement_table(lines, units_in(design).degrees, "Requirements (* our default)")


def requirements_with_margins(design: WorkspaceEvidence) -> list[Requirement]:
    """The requirements; those on gain and delay with what the worst pose tolerates, if it is stable."""
    if max(loop.growth for loop in design.loops) >= 1.0:
        return list(design.requirements)
    t = design.robustness
    known = {
        "gain_margin": f"gain of {margin_text(min(t.louder, 1.0 / t.softer), LOUDEST)} tolerated",
        "delay_margin": f"{margin_text(t.delay, LATEST)} samples tolerated",
    }
    return [replace(line, detail=known.get(line.field, line.detail)) for line in design.requirements]


def _starts(design: WorkspaceEvidence) -> str:
    """How far links move by an unknown load at power-on, and by offsets of the encoders, where it is much."""
    setup, run, texts = design.setup, design.power_on, list[str]()
    units, offsets = units_in(design), design.robustness.offsets[1]
    sizes = {
        "at power-on {} in the first second": 0.0 * offsets
        if run is None
        else peak_of(run.positions - run.goal),
        f"by encoders that are off by {units.small_text(OFFSET, 2)} {{}}": offsets
        * (setup.noise is not None),
    }
    for text, moved in sizes.items():
        if FAR < moved.max() < np.inf:
            k = int(np.argmax(moved))
            joint = setup.joints[k]
            texts.append(text.format(f"{joint} moves by up to {units.small_text(moved[k], 3, joint)}"))
    text = "; ".join(texts)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def range_of(task: Task, s: Specification, units: Units) -> str:
    """The poses that a controller is for, in words."""
    space, motion = task.space, task.motion
    if motion is not None:
        return pose_task(units.each_text(units.scale * motion.goal, units.angle))
    where = "the joint ranges" if s.workspace == LIMITS else "the stated ranges of the joints"
    where = where if space.path is None else "the stated waypoints"
    return "the stated box in space" if space.box is not None else where


def poses_of(design: WorkspaceEvidence) -> str:
    """As `range_of`, of a design."""
    return range_of(design.setup.task, design.specification, units_in(design))


def worst_motion(moves: Sequence[Move], places: Sequence[int] | None = None) -> list[dict[str, float]]:
    """The worst joint of each move, of all or of those at some places, by the keys of `COLUMNS`; NaN where a number
    does not exist, as a ripple without limits of the motors."""
    rows: list[dict[str, float]] = []
    for move in moves:
        found = move.motion
        kept = found if places is None or not found else [found[k] for k in places]
        rows.append({key: _largest([row.get(key) for row in kept], bool(found)) for key in COLUMNS})
    return rows


def columns_of(design: WorkspaceEvidence) -> dict[str, tuple[str, str, Number]]:
    """Those of `COLUMNS` that the robot has: title, unit and factor, small deviations in the units of the joints."""
    small, limited = units_in(design).small, design.setup.limits.limits_effort
    rows = [row for move in (*design.moves, *design.sampled) for row in move.motion]
    measured = {key for row in rows for key in row} if rows else {*COLUMNS}
    kept = {
        key: row for key, row in COLUMNS.items() if key in measured and (limited or key != "ripple_percent")
    }
    return {
        key: (title, unit, 1.0) if unit else (title, small[0], small[1])
        for key, (title, unit) in kept.items()
    }


def _largest(values: Sequence[float | None], exists: bool = True) -> float:
    """The largest value that is known; NaN if none is, infinite where a run diverged and has none."""
    return max((value for value in values if value is not None), default=np.nan) if exists else np.inf


def _worst_joint(moves: Sequence[Move], key: str) -> str:
    """The joint that has the largest of a number of all moves; "" where none is known."""
    known = [
        (value, joint)
        for move in moves
        for joint, row in zip(move.response.joints, move.motion)
        if (value := row.get(key)) is not None
    ]
    return max(known, default=(0.0, ""))[1]


def key_numbers(design: WorkspaceEvidence) -> list[Fact]:
    """The worst numbers of poses and moves."""
    moves = (*design.moves, *design.sampled)
    rows, least = worst_motion(moves), min(l.damping for l in (*design.loops, *design.corner_loops))
    below, worst = (
        f"below {number(design.specification.damped_below_limit, 3)} rad/s",
        design.setup.motions(len(moves)),
    )
    numbers = [Fact("least damping", number(least, 3), "", below)]
    for key, (title, unit, factor) in columns_of(design).items():
        values, where = [row[key] for row in rows], worst
        if key == "ripple_percent":  # at rest every pose has one, and its requirement is the same
            values += [loop.ripple for loop in design.loops]
            where = f"{worst}, and {poses_text(design)}"
        units, joint = units_in(design), _worst_joint(moves, key)
        if " or " in unit:
            where = f"{joint}; {where}"
        scale = units.factor_of(factor, joint) if joint else 1.0
        largest = number(scale * float(np.fmax.reduce(values)), 3)
        numbers.append(Fact(title, largest, units.of(unit, joint), where))
    return numbers


def margin_text(value: float, most: float, before: str = "") -> str:
    """A margin that is searched for up to `most`."""
    return f"{before}{number(value, 3)}" if value < 0.99 * most else f"beyond {before}{most:g}"


def command_text(advice: Advice | None) -> str:
    """The command of the change that meets all, where one was found and there is a command."""
    return (
        f" The whole command: {shlex.join(advice.command)}" if advice is not None and advice.command else ""
    )
