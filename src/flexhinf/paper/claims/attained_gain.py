"""The loop has the gain of Eq. (5): ∫|z|² ≤ γ² ∫|d|² from x(0) = 0.

d is the paper's disturbance, the command in ė = x1 − d, and z = (60 x1, 300 x5, √R2 u): the effort counts. A step
command has infinite energy, so its ratio is over a horizon only and Eq. (5) says nothing of it: pulses and decaying
sines are run, and the worst disturbance of several energies is searched for. What is attained is a lower bound of the
gain. Eq. (5) is a local statement, so what lies beyond ±180° is shown and not judged.

The loop withstands step and sinusoidal disturbances after a command of 90° given at 2 s.

The paper gives neither size nor place nor frequency of its disturbances. Both claims are judged for a torque of a
fifth of the largest gravity torque, at the link and at the motor; the sine at 0.5 Hz, with other frequencies shown.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from flexhinf.hinf import HJISolution
from flexhinf.loop import Sine, Step, Trajectory
from flexhinf.paper.claims.judgement import Judged, damped_law, repair_by_damping
from flexhinf.paper.disturbance_gain import HORIZON, GainRuns, RunGain, stated_disturbances
from flexhinf.paper.experiments import (
    CHANNELS,
    FREQUENCY,
    LOAD_DURATION,
    LOAD_FROM,
    TORQUE,
    Experiments,
    load_numbers,
)
from flexhinf.paper.loop_setup import PaperSetup
from flexhinf.report import (
    MUTED,
    SERIES,
    Claim,
    Column,
    Figure,
    Table,
    figure_to_svg,
    house_style,
    label,
    legend,
    new_figure,
)

TEXT = "From rest, ∫|z|² ≤ γ² ∫|d|² for disturbances of finite energy (Eq. 5)."

CRITERION = (
    "On the nominal arm with the true state fed back, no disturbance tried or found by search that keeps the link "
    "within ±180° of the hanging rest attains √(∫|z|²/∫|d|²) above γ. A search gives a lower bound of the gain and "
    "proves nothing."
)

#: ∫|d|² of the worst disturbances searched for, rad² s.
ENERGIES = (1e-4, 0.1, 1.0, 3.0, 10.0, 20.0, 30.0, 60.0, 100.0)

Named = tuple[str, RunGain]


def judge(setup: PaperSetup) -> Judged:
    """gain-attained."""
    runs = GainRuns(setup, setup.nonlinear)
    stated = [(name, runs.attained(d)) for name, d in stated_disturbances()]
    worst = _searched(runs)
    judged = [a for _, a in (*stated, *worst) if a.inside]  # a run that diverged reaches farther
    largest = max((a.gain for a in judged), default=math.inf)
    holds = largest <= setup.gamma
    claim = Claim(
        "gain-attained",
        TEXT,
        "holds" if holds else "fails",
        _evidence(setup, largest, stated, worst),
        "" if holds else repair_by_damping(setup, lambda s: _holds_with(setup, damped_law(setup, s))),
        ("table-gain", "figure-gain"),
        CRITERION,
    )
    known = largest if math.isfinite(largest) else None
    numbers = {
        "largest_gain": known,
        "largest_gain_over_gamma": known and known / setup.gamma,
        "largest_gain_over_gamma_star": known and known / setup.gamma_star,
    }
    return Judged(claim, (_table(setup, stated, worst), _figure(setup, worst)), numbers)


def _holds_with(setup: PaperSetup, law: HJISolution) -> bool:
    """The stated disturbances and the worst found, with another law, against that law's own γ."""
    runs = GainRuns(setup, law)
    found = [*(runs.attained(d) for _, d in stated_disturbances()), *(a for _, a in _searched(runs))]
    return max((a.gain for a in found if a.inside), default=math.inf) <= law.gamma


def _searched(runs: GainRuns) -> list[Named]:
    found = runs.searched(ENERGIES)
    return [(f"worst found, ∫|d|² = {e:g}", a) for e, a in zip(ENERGIES, found, strict=False)]


# What is shown --------------------------------------------------------------------------------------
def _evidence(setup: PaperSetup, largest: float, stated: list[Named], worst: list[Named]) -> str:
    tame = max((a.gain for _, a in stated if a.inside), default=math.inf)
    if not math.isfinite(max(tame, largest)):
        return f"γ = {setup.gamma:.1f}, γ* = {setup.gamma_star:.1f}: the loop diverges under most disturbances tried."
    text = (
        f"γ = {setup.gamma:.1f}, γ* = {setup.gamma_star:.1f}. With |x1| ≤ 180° pulses and decaying sines attain up to "
        f"{tame:.1f}, the worst disturbances found up to {largest:.1f}: {largest / setup.gamma:.3f} γ, "
        f"{largest / setup.gamma_star:.3f} γ*."
    )
    beyond = [a for _, a in (*stated, *worst) if a.gain > setup.gamma and not a.inside]
    if not beyond:
        return f"{text} Nothing tried exceeds γ, within {HORIZON:g} s."
    first = min(beyond, key=lambda a: a.energy if math.isfinite(a.energy) else math.inf)
    gain = "diverges" if math.isinf(first.gain) else f"attains {first.gain:.1f}"
    reach = "" if math.isinf(first.reach) else f", with |x1| up to {math.degrees(first.reach):.0f}°"
    return f"{text} Eq. (5) is local: with ∫|d|² = {first.energy:.3g} rad² s the loop {gain}{reach}."


def _table(setup: PaperSetup, stated: list[Named], worst: list[Named]) -> Table:
    rows = []
    for name, a in (*stated, *worst):
        known = math.isfinite(a.gain)
        energy = a.energy if math.isfinite(a.energy) else None
        reach = math.degrees(a.reach) if math.isfinite(a.reach) else None
        ratios = (a.gain, a.gain / setup.gamma, a.gain / setup.gamma_star) if known else (None, None, None)
        rows.append((name, energy, reach, *ratios))
    columns = (
        "disturbance d",
        Column("∫|d|²", "rad² s"),
        Column("largest |x1|", "°", 1),
        Column("attained √(∫|z|²/∫|d|²)", "", 1),
        Column("over γ", "", 3),
        Column("over γ*", "", 3),
    )
    caption = (
        "Attained gain of Eq. (5) from rest, true state fed back, the largest over all horizons up to 20 s."
    )
    return Table(columns, rows, caption, "table-gain")


@house_style()
def _figure(setup: PaperSetup, worst: list[Named]) -> Figure:
    figure, (axes,) = new_figure(height=3.0)
    known = [a for _, a in worst if math.isfinite(a.gain)]
    inside, outside = ([a for a in known if a.inside == within] for within in (True, False))
    energies = np.array([a.energy for a in known])
    axes.plot(energies, np.array([a.gain for a in known]), color=SERIES[0], linewidth=1.2)
    for chosen, marker, fill, name in (
        (inside, "o", SERIES[0], "worst found, |x1| ≤ 180°"),
        (outside, "o", "none", "worst found, |x1| beyond 180°"),
    ):
        points = np.array([[a.energy, a.gain] for a in chosen]).reshape(-1, 2)
        axes.plot(
            points[:, 0],
            points[:, 1],
            marker,
            color=SERIES[0],
            markerfacecolor=fill,
            markersize=5,
            label=name,
        )
    axes.axhline(setup.gamma, color=SERIES[1], linewidth=1.4, label="γ of the design")
    axes.axhline(setup.gamma_star, color=MUTED, linewidth=1.2, linestyle=(0, (4.0, 2.2)), label="γ*")
    axes.set_xlim(0.7 * ENERGIES[0], 1.4 * ENERGIES[-1])  # first: one known energy alone has no range
    axes.set_xscale("log")
    axes.set_ylim(0.0, None)
    axes.set_xlabel("energy of the disturbance, ∫|d|² (rad² s)")
    label(axes, "attained gain", "")
    legend(axes)
    caption = (
        "The largest √(∫|z|²/∫|d|²) found by ascent on the disturbance, a lower bound of the loop's gain, against "
        "the γ of the design and γ* of the paper's problem."
    )
    return Figure("figure-gain", figure_to_svg(figure), caption)


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
