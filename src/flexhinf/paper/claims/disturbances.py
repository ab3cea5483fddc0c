"""The loop withstands step and sinusoidal disturbances after a command of 90° given at 2 s.

The paper gives neither size nor place nor frequency of its disturbances. Both claims are judged for a torque of a
fifth of the largest gravity torque, at the link and at the motor; the sine at 0.5 Hz, with other frequencies shown.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from flexhinf.loop import Sine, Step, Trajectory
from flexhinf.paper.claims.judgement import Judged, damped_law, repair_by_damping
from flexhinf.paper.experiments import (
    CHANNELS,
    FREQUENCY,
    LOAD_DURATION,
    LOAD_FROM,
    TORQUE,
    Experiments,
    load_numbers,
)
from flexhinf.report import Claim, Column, Table

LIMIT = 0.20 * math.pi / 2
FREQUENCIES = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)


def _where(channel: str) -> str:
    return channel.replace("_torque", "")


def judge_step_disturbance(experiments: Experiments) -> Judged:
    """withstands-step-disturbance."""
    found = {c: load_numbers(experiments.step_disturbance[c]) for c in CHANNELS}
    holds = all(_recovers(experiments.step_disturbance[c]) for c in CHANNELS)
    fed_back = experiments.load_response(
        experiments.setup.nonlinear, Step(TORQUE, at=LOAD_FROM), estimator=None
    )
    rows = [(_where(c), *_shown(found[c])) for c in CHANNELS]
    rows.append(("link, true state fed back", *_shown(load_numbers(fed_back))))
    claim = Claim(
        "withstands-step-disturbance",
        "The loop withstands a step disturbance after a 90° command given at 2 s.",
        "holds" if holds else "fails",
        _step_text(found),
        "" if holds else _repaired(experiments, Step(TORQUE, at=LOAD_FROM), _recovers),
        ("figure-11", "table-step-disturbance"),
        f"With a torque step of {TORQUE:g} N·m at {LOAD_FROM:g} s, at the link or at the motor, the link comes back "
        f"within ±2 % of the command's step before {LOAD_DURATION:g} s and stays.",
    )
    columns = ("torque at the", Column("largest deviation", "°", 2), Column("time of recovery", "s", 2))
    caption = f"Torque step of {TORQUE:g} N·m; – where the link does not come back or diverges."
    return Judged(claim, (Table(columns, rows, caption, "table-step-disturbance"),))


def _shown(numbers: dict[str, Any]) -> tuple[float | None, float | None]:
    peak = numbers["peak_deviation_rad"]
    return None if peak is None else math.degrees(peak), numbers["recovery_time_s"]


def _step_text(found: dict[str, dict[str, Any]]) -> str:
    peaks = [numbers["peak_deviation_rad"] for numbers in found.values()]
    if any(peak is None for peak in peaks):
        return "The loop diverges."
    lost = [_where(c) for c, numbers in found.items() if numbers["recovery_time_s"] is None]
    text = f"The link moves by at most {math.degrees(max(peaks)):.1f}°"
    if lost:
        return (
            f"{text} and is not back within ±2 % at the end with the torque at the {' and the '.join(lost)}."
        )
    latest = max(numbers["recovery_time_s"] for numbers in found.values())
    return f"{text} and is back within ±2 % after {latest:.2f} s at the latest."


def _grows(run: Trajectory) -> bool:
    error = np.abs(run.tracked("link_position") - run.signals["reference"][:, 0])
    end = run.time[-1]
    last, before = (
        error[(run.time > end - a) & (run.time <= end - b)].max() for a, b in ((2.0, 0.0), (4.0, 2.0))
    )
    return bool(last > 1.05 * before + 1e-4)


def _recovers(run: Trajectory) -> bool:
    return load_numbers(run)["recovery_time_s"] is not None


def _stays(run: Trajectory, growth: bool = True) -> bool:
    peak = load_numbers(run)["peak_deviation_rad"]
    return peak is not None and peak <= LIMIT and not (growth and _grows(run))


def _repaired(experiments: Experiments, signal: Any, passes: Callable[[Trajectory], bool]) -> str:
    """The smallest weights on the other states with which it holds at the link and at the motor."""

    def holds(scale: float) -> bool:
        law = damped_law(experiments.setup, scale)
        return all(passes(experiments.load_response(law, signal, channel)) for channel in CHANNELS)

    return repair_by_damping(experiments.setup, holds)


def judge_sine_disturbance(experiments: Experiments) -> Judged:
    """withstands-sine-disturbance, over frequencies."""
    rows, passed = [], {}
    law = experiments.setup.nonlinear
    for frequency in FREQUENCIES:
        row: list[object] = [frequency]
        for channel in CHANNELS:
            run = experiments.sine_disturbance[channel]
            if frequency != FREQUENCY:
                run = experiments.load_response(law, Sine(TORQUE, frequency, at=LOAD_FROM), channel)
            row.append(_shown(load_numbers(run))[0])
            # Growth can be told from phase only with a whole period in two seconds.
            passed[frequency, channel] = _stays(run, growth=2.0 * frequency >= 1.0)
        rows.append(row)
    holds = all(passed[FREQUENCY, c] for c in CHANNELS)
    bad = sorted({f for (f, _), ok in passed.items() if not ok})
    peaks = next(row[1:] for row in rows if row[0] == FREQUENCY)
    shown = " and ".join("diverged" if p is None else f"{p:.1f}°" for p in peaks)
    evidence = f"At {FREQUENCY:g} Hz the link moves by at most {shown} (torque at link and at motor). " + (
        f"The criterion is not kept at {', '.join(f'{f:g}' for f in bad)} Hz."
        if bad
        else "It is kept at the other frequencies tried too."
    )
    claim = Claim(
        "withstands-sine-disturbance",
        "The loop withstands a sinusoidal disturbance after a 90° command given at 2 s.",
        "holds" if holds else "fails",
        evidence,
        "" if holds else _repaired(experiments, Sine(TORQUE, FREQUENCY, at=LOAD_FROM), _stays),
        ("figure-12", "table-frequencies"),
        f"With a torque of {TORQUE:g} N·m at {FREQUENCY:g} Hz from {LOAD_FROM:g} s on, at the link or at the motor, "
        "the link stays within 18° (20 % of the command), and the last two seconds deviate at most 5 % more than the "
        "two before.",
    )
    table = Table(
        (
            Column("frequency", "Hz", 2),
            Column("torque at the link: largest deviation", "°", 2),
            Column("torque at the motor: largest deviation", "°", 2),
        ),
        rows,
        f"Torque of {TORQUE:g} N·m from {LOAD_FROM:g} s on. The paper gives neither size, place nor frequency.",
        "table-frequencies",
    )
    return Judged(claim, (table,))
