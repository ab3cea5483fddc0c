"""The loop withstands step and sinusoidal disturbances after a command of 90° given at 2 s.

Criteria, for a torque of a fifth of the largest gravity torque, at the link and at the motor. Step: the
position comes back within ±2 % of the command in the run and stays. Sine: it stays within 20 % of the
command, 18°, and does not grow: the last two seconds deviate at most 5 % more than the two before.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from flexhinf.loop import Sine, Step
from flexhinf.paper.claims.damping import damped_law, repair_by_damping
from flexhinf.paper.claims.judged import Judged
from flexhinf.paper.experiments import CHANNELS, DISTURBED_FROM, FREQUENCY, TORQUE, Experiments
from flexhinf.paper.figures.drawn import disturbance_numbers
from flexhinf.report import Claim, Column, Table

__all__ = ["judge_sine_disturbance", "judge_step_disturbance"]

LIMIT = 0.20 * math.pi / 2
FREQUENCIES = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)


def _where(channel: str) -> str:
    return channel.replace("_torque", "")


def judge_step_disturbance(experiments: Experiments) -> Judged:
    """withstands-step-disturbance."""
    found = {c: disturbance_numbers(experiments.step_disturbance[c]) for c in CHANNELS}
    holds = all(_recovers(experiments.step_disturbance[c]) for c in CHANNELS)
    parts = []
    for channel, f in found.items():
        if f["peak_deviation_rad"] is None:
            parts.append(f"{_where(channel)}: diverged")
            continue
        back = f["recovery_time_s"]
        parts.append(
            f"{_where(channel)}: {math.degrees(f['peak_deviation_rad']):.1f}° at most, "
            + (f"back within ±2 % after {back:.2f} s" if back is not None else "not back within ±2 %")
        )
    fed_back = experiments.disturbed(
        experiments.bench.nonlinear, Step(TORQUE, at=DISTURBED_FROM), estimator=None
    )
    true_peak = disturbance_numbers(fed_back)["peak_deviation_rad"]
    if true_peak is not None and experiments.bench.settings.estimator != "none":
        parts.append(f"with the true state fed back {math.degrees(true_peak):.1f}° at the link")
    claim = Claim(
        "withstands-step-disturbance",
        "The loop withstands a step disturbance after a 90° command given at 2 s (comes back within ±2 %).",
        "holds" if holds else "fails",
        f"Torque step of {TORQUE:g} N·m at {DISTURBED_FROM:g} s; " + "; ".join(parts) + ".",
        "" if holds else _repaired(experiments, Step(TORQUE, at=DISTURBED_FROM), _recovers),
        ("figure-11",),
    )
    return Judged(claim)


def _grows(outcome: Any) -> bool:
    run = outcome.run
    error = np.abs(run.tracked("link_position") - run.signals["reference"][:, 0])
    end = run.time[-1]
    last, before = (
        error[(run.time > end - a) & (run.time <= end - b)].max() for a, b in ((2.0, 0.0), (4.0, 2.0))
    )
    return bool(last > 1.05 * before + 1e-4)


def _recovers(outcome: Any) -> bool:
    return disturbance_numbers(outcome)["recovery_time_s"] is not None


def _stays(outcome: Any, growth: bool = True) -> bool:
    peak = disturbance_numbers(outcome)["peak_deviation_rad"]
    return peak is not None and peak <= LIMIT and not (growth and _grows(outcome))


def _repaired(experiments: Experiments, signal: Any, passes: Callable[[Any], bool]) -> str:
    """The smallest weights on the other states with which it holds at the link and at the motor."""

    def holds(scale: float) -> bool:
        law = damped_law(experiments.bench, scale)
        return all(passes(experiments.disturbed(law, signal, channel)) for channel in CHANNELS)

    return repair_by_damping(experiments.bench, holds)


def judge_sine_disturbance(experiments: Experiments) -> Judged:
    """withstands-sine-disturbance, over frequencies."""
    rows, passed = [], {}
    law = experiments.bench.nonlinear
    for frequency in FREQUENCIES:
        row: list[object] = [frequency]
        for channel in CHANNELS:
            outcome = experiments.disturbed(law, Sine(TORQUE, frequency, at=DISTURBED_FROM), channel)
            peak = disturbance_numbers(outcome)["peak_deviation_rad"]
            row.append(None if peak is None else math.degrees(peak))
            steady = (
                frequency * 2.0 >= 1.0
            )  # a whole period in two seconds, else growth cannot be told from phase
            passed[frequency, channel] = (
                peak is not None and peak <= LIMIT and not (steady and _grows(outcome))
            )
        rows.append(row)
    holds = all(passed[FREQUENCY, c] for c in CHANNELS)
    bad = sorted({f for (f, _), ok in passed.items() if not ok})
    peaks = next(row[1:] for row in rows if row[0] == FREQUENCY)
    shown = " and ".join("diverged" if p is None else f"{p:.1f}°" for p in peaks)
    evidence = f"Torque of {TORQUE:g} N·m at {FREQUENCY:g} Hz: at most {shown} (link and motor). " + (
        f"The limit of 18° is not kept at {', '.join(f'{f:g}' for f in bad)} Hz."
        if bad
        else "Kept at every frequency tried."
    )
    claim = Claim(
        "withstands-sine-disturbance",
        "The loop withstands a sinusoidal disturbance after a 90° command given at 2 s "
        "(stays within 18° and does not grow).",
        "holds" if holds else "fails",
        evidence,
        "" if holds else _repaired(experiments, Sine(TORQUE, FREQUENCY, at=DISTURBED_FROM), _stays),
        ("figure-12", "table-frequencies"),
    )
    table = Table(
        (
            Column("frequency", "Hz", 2),
            Column("torque at the link: largest deviation", "°", 2),
            Column("torque at the motor: largest deviation", "°", 2),
        ),
        rows,
        f"Torque of {TORQUE:g} N·m from {DISTURBED_FROM:g} s on. The paper gives neither size, place nor frequency.",
        "table-frequencies",
    )
    return Judged(claim, (table,))
