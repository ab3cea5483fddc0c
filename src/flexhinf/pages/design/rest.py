"""The loop at rest at the goal: a long run with dry friction, and how it comes to rest after an impulse."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from flexhinf.design.impulse import AFTER, ImpulseRuns
from flexhinf.design.limit_cycle import WIDEST, LimitCycleCheck
from flexhinf.design.problem.presets import preset_of
from flexhinf.design.result import Design
from flexhinf.loop.simulation.metrics import REST_TAIL, VISIBLE, tail_of
from flexhinf.pages.drawing import DASHED, Panel, figure_block, joint_table, listed, time_figure, units_of
from flexhinf.report import MUTED, Column, Figure, Table, number
from flexhinf.robot.elastic import DRY

#: Pieces of the run in the figure: of each the extremes are drawn, so that no vibration is lost.
PIECES = 400

#: An oscillation of at least this fraction of the limit has its frequency in the table.
SEEN = 0.5

#: The figure of the ring-down ends after so many periods of the least damped oscillation.
SHOWN = 8.0


def blocks(design: Design) -> list[Any]:
    """Figure and table; nothing for a robot without dry friction, or a run that diverged."""
    run = design.rest
    return [] if run is None or not run.cycles else [_figure(design, run), rest_table(design, run)]


def remarks(design: Design) -> Iterator[str]:
    """Which joints keep moving, and what may be tried."""
    run, s = design.rest, design.specification
    if run is not None and run.without is not None:
        before, worst = run.without, run.without.worst
        yield (
            f"Dry friction and integral action would keep the robot moving: {_motion(design, before, worst)}. "
            f"So errors up to {_zone(design, run)} are not integrated; they may remain. "
            "`--integral-dead-zone` states another zone, 0 none."
        )
    if run is None or not run.oscillates:
        return
    if not run.cycles:
        yield "The long run at rest with the robot's dry friction diverges."
        return
    joints = [_motion(design, run, k) for k in run.oscillating]
    extras = ",".join(dict.fromkeys((*s.extras, *(name for name in run.extras if name in DRY))))
    both = all(
        any(name.startswith(side) for name in s.measured) for side in ("link_position", "motor_position")
    )
    advice = [
        *([] if s.friction_model else [f"`--extras {extras} --friction-model`"]),
        "another `--integral-dead-zone`",
        *([] if both else ["sensors on both sides of the springs"]),
        *(
            ["weights that damp the vibration (`--preset damped`)"]
            if preset_of(design.evaluation.setup.robot, s) == "paper"
            else []
        ),
    ]
    narrow = ""
    if run.tried is not None and run.tried.cycles:
        narrow = (
            f" Errors up to {_zone(design, run.tried)} left unintegrated do not end it: "
            f"{_motion(design, run.tried, run.tried.worst)}. The design sets no dead zone above "
            f"{100.0 * WIDEST:g} % of the joint's step by itself; a wider one may leave an error as large as itself."
        )
    yield (
        f"With dry friction the robot does not come to rest: {listed(joints)}.{narrow} Try {' or '.join(advice)}."
    )


def _motion(design: Design, run: LimitCycleCheck, joint: int) -> str:
    cycle = run.cycles[joint]
    return f"{run.response.joints[joint]} by ±{_length(design, cycle.amplitude, 3)} ({_frequency(cycle.frequency)})"


def _zone(design: Design, run: LimitCycleCheck) -> str:
    """The dead zone of the integrals of a run, of the joints that have one."""
    joints, sizes = run.response.joints, [] if run.dead_zone is None else run.dead_zone.tolist()
    where = [f" in {joint}" if len(joints) > 1 else "" for joint in joints]
    return listed([f"{_length(design, size, 2)}{name}" for name, size in zip(where, sizes) if size > 0.0])


def _length(design: Design, value: float, digits: int) -> str:
    unit, scale = units_of(design.evaluation).small
    return f"{number(scale * value, digits)}{'' if unit == '°' else ' '}{unit}"


def _frequency(frequency: float | None) -> str:
    """Of an oscillation, with its period where it is slow."""
    if frequency is None:
        return "less than one period in the last half"
    slow = f", every {number(1.0 / frequency, 3)} s" if frequency < 1.0 else ""
    return f"{number(frequency, 3)} Hz{slow}"


def _figure(design: Design, run: LimitCycleCheck) -> Figure:
    response, units = run.response, units_of(design.evaluation)
    unit, scale = units.small
    time, positions, inputs = (
        tail_of(each, REST_TAIL) for each in (response.run.time, response.positions, response.inputs)
    )
    few, deviation = _extremes(time, scale * (positions - response.goal))
    limit = np.full(len(response.joints), scale * run.limit)
    panels = (
        Panel("link position − goal", unit, deviation, zero=True, limits=limit, limit_name="limit"),
        Panel("input", units.effort, _extremes(time, inputs)[1]),
    )
    return figure_block(
        "rest", time_figure(few, response.joints, panels)[0],
        f"The last half of {response.run.time[-1]:.3g} s at the goal, without measurement noise. Dry friction is "
        f"{'sharp: it holds a motor until the torque exceeds it' if run.sharp else 'smoothed'}. An amplitude beyond "
        f"{_length(design, run.limit, 3)} is hunting.",
        "At rest with dry friction",
    )  # fmt: skip


def _extremes(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and rows (N, n) of the extremes in `PIECES` pieces, the smallest first where a signal rises."""
    times, rows = [], []
    for piece in np.array_split(np.arange(len(time)), min(PIECES, len(time))):
        part = values[piece]
        low, high, rises = part.min(axis=0), part.max(axis=0), part[-1] >= part[0]
        times += [time[piece[0]], time[piece[-1]]]
        rows += [np.where(rises, low, high), np.where(rises, high, low)]
    return np.array(times), np.array(rows)


def rest_rows(run: LimitCycleCheck) -> list[dict[str, Any]]:
    """Of each joint: amplitude and frequency of what still moves, and the remaining error; none of a run that
    diverged."""
    return [
        {
            "joint": joint,
            "amplitude": cycle.amplitude,
            "frequency_Hz": cycle.frequency,
            "remaining_error": error,
        }
        for joint, cycle, error in zip(run.response.joints, run.cycles, run.errors.tolist())
    ]


def rest_table(design: Design, run: LimitCycleCheck) -> Table:
    """Amplitude, frequency and remaining error of each joint."""
    unit, scale = units_of(design.evaluation).small
    rows = [
        {
            **row,
            "frequency": _frequency(row["frequency_Hz"]) if row["amplitude"] > SEEN * run.limit else "–",
            "result": "hunts" if row["amplitude"] > run.limit else "below the limit",
        }
        for row in rest_rows(run)
    ]
    columns = (
        Column("joint", key="joint"),
        Column("amplitude", unit, key="amplitude", scale=scale),
        Column("frequency", key="frequency"),
        Column("remaining error", unit, key="remaining_error", scale=scale),
        Column("result", key="result"),
    )
    zone = "" if run.dead_zone is None else ", and a dead zone of the integrals"
    friction = [name.replace("_", " ") for name in run.extras if name in DRY]
    caption = (
        f"With {listed(friction)}{zone}. Amplitude: half of the distance between the extremes in the last half. "
        "Remaining error: largest in the last tenth"
    )
    title = f"{run.response.run.time[-1]:.3g} s at rest with dry friction: hunting"
    return joint_table(Table.of(columns, rows, caption, "table-hunting", title=title))


# Ring-down after an impulse ---------------------------------------------------------------------------
def ring_down_blocks(design: Design) -> list[Any]:
    """Figure and table; nothing where a run diverged."""
    runs = design.evaluation.ring_down
    return [] if runs.ring_down is None else [_ring_down_figure(runs), _ring_down_table(design, runs)]


def ring_down_remarks(design: Design) -> Iterator[str]:
    """A run that diverges, or that is no decaying oscillation."""
    runs = design.evaluation.ring_down
    if runs.ring_down is None:
        yield f"After a blow on {runs.responses[runs.worst].joints[runs.worst]} at the goal the loop diverges."
    elif not runs.exponential:
        left = "comes to rest" if runs.ring_down.rests else "does not come to rest"
        yield (
            "After a blow the loop does not decay as a linear one does (dry friction, backlash or limits), and "
            f"{left}; the damping ratios are those of the nearest decaying oscillations."
        )


def ring_down_rows(runs: ImpulseRuns) -> list[dict[str, Any]]:
    """Of each joint: impulse, largest deviation of its link, least damped oscillation, and what is left of it."""
    rows, found = [], runs.ring_down
    for k, response in enumerate(runs.responses):
        least = runs.least_damped(k)
        deviation = float(np.abs(response.positions[:, k] - response.goal[k]).max())
        rows.append(
            {
                "joint": response.joints[k],
                "impulse": float(runs.impulses[k]),
                "peak_deviation": None if found is None else deviation,
                "damping": None if found is None else found.damping_of(k),
                "frequency_Hz": None if least is None else least.frequency,
                "left": None if found is None else runs.left(k),
            }
        )
    return rows


def _ring_down_figure(runs: ImpulseRuns) -> Figure:
    joints, time, worst = runs.responses[0].joints, runs.responses[0].run.time, runs.worst
    least = runs.least_damped(worst)
    shown = time <= (time[-1] if least is None else SHOWN / least.frequency)
    values = np.column_stack([runs.velocity(k)[shown] for k in range(len(joints))])
    figure, axes = time_figure(
        time[shown], joints, [Panel("link velocity / peak", "", values, zero=True)], 2.9
    )
    caption = (
        "Velocity of each link after an impulse on it at the goal, over its peak; without measurement noise."
    )
    if least is not None and least.damping > 0.0:
        # The envelope begins at the peak: what decays slower is not the oscillation whose damping is given.
        envelope = np.exp(-2.0 * np.pi * least.frequency * least.damping * time[shown])
        for sign in (1.0, -1.0):
            axes[0].plot(time[shown], sign * envelope, color=MUTED, linewidth=1.0, dashes=DASHED)
        where = f" ({joints[worst]})" if len(joints) > 1 else ""
        caption += (
            f" Dashed: the decay of the least damped oscillation{where}, {number(least.frequency, 3)} Hz with a "
            f"damping ratio of {number(least.damping, 2)}."
        )
    return figure_block("ringing", figure, caption, "After an impulse")


def _ring_down_table(design: Design, runs: ImpulseRuns) -> Table:
    units = units_of(design.evaluation)
    unit, scale = units.small
    columns = (
        Column("joint", key="joint"),
        Column("impulse", f"{units.load}·s", key="impulse"),
        Column("largest deviation", unit, key="peak_deviation", scale=scale),
        Column("least damping ratio", "", 3, key="damping"),
        Column("its frequency", "Hz", 3, key="frequency_Hz"),
        Column(f"left after {AFTER:g} periods", "%", 2, key="left", scale=100.0),
    )
    error = 0.0 if runs.ring_down is None else runs.ring_down.error
    caption = (
        "An impulse on the link, the loop at rest at the goal. Damping ratio: the least of the oscillations that make "
        f"up {100.0 * VISIBLE:g} % of the joint's own velocity or input, fitted to all samples of all runs; fit and "
        f"runs differ by {number(100.0 * error, 2)} % of the peak at most. Left: largest velocity of the link from "
        "then on, of its peak"
    )
    return joint_table(Table.of(columns, ring_down_rows(runs), caption, "table-ring-down"))
