"""The gain of Eq. (5) is attained: ∫|z|² ≤ γ² ∫|d|² from x(0) = 0.

d is the paper's disturbance, the command in ė = x1 − d, and z = (60 x1, 300 x5, √R2 u): the effort counts. The
true state is fed back at the period of the settings, the arm is nominal. A step command has infinite energy, so
its ratio is over a horizon only and Eq. (5) says nothing of it: pulses and decaying sines are run, and the worst
disturbance of several energies is searched for. Criterion: no disturbance that keeps the link within ±180° of the
hanging rest attains more than γ. Eq. (5) is a local statement, so what lies beyond is shown and not judged.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from flexhinf.hinf import HJISolution
from flexhinf.paper.bench import PaperBench
from flexhinf.paper.claims.damping import damped_law, repair_by_damping
from flexhinf.paper.claims.judged import Judged
from flexhinf.paper.worst_disturbance import HORIZON, Attained, GainBench
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

__all__ = ["judge"]

TEXT = "From rest, ∫|z|² ≤ γ² ∫|d|² for disturbances of finite energy (Eq. 5)."

#: Inside this |x1|, rad, the claim is judged: the paper's largest command.
RANGE = math.pi

#: ∫|d|² of the worst disturbances searched for, rad² s, and turns of the search for the first and for the others.
ENERGIES = (1e-4, 0.1, 1.0, 3.0, 10.0, 20.0, 30.0, 60.0, 100.0)
FIRST_TURNS, TURNS = 60, 12

Named = tuple[str, Attained]


def judge(bench: PaperBench) -> Judged:
    """gain-attained."""
    runs = GainBench(bench, bench.nonlinear)
    stated = [(name, runs.attained(d)) for name, d in _stated()]
    worst = _searched(runs)
    judged = [a for _, a in (*stated, *worst) if a.reach <= RANGE]  # a run that diverged reaches farther
    largest = max((a.gain for a in judged), default=math.inf)
    holds = largest <= bench.gamma
    claim = Claim(
        "gain-attained",
        TEXT,
        "holds" if holds else "fails",
        _evidence(bench, largest, stated, worst),
        "" if holds else repair_by_damping(bench, lambda s: _holds_with(bench, damped_law(bench, s))),
        ("table-gain", "figure-gain"),
    )
    known = largest if math.isfinite(largest) else None
    numbers = {
        "largest_gain": known,
        "largest_gain_over_gamma": known and known / bench.gamma,
        "largest_gain_over_gamma_star": known and known / bench.gamma_star,
    }
    return Judged(claim, (_table(bench, stated, worst), _figure(bench, worst)), numbers)


def _holds_with(bench: PaperBench, law: HJISolution) -> bool:
    """The stated disturbances and the worst found, with another law, against that law's own γ."""
    runs = GainBench(bench, law)
    found = [*(runs.attained(d) for _, d in _stated()), *(a for _, a in _searched(runs))]
    return max((a.gain for a in found if a.reach <= RANGE), default=math.inf) <= law.gamma


# Disturbances ---------------------------------------------------------------------------------------
def _pulse(height: float, width: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda t: np.where(t < width, height, 0.0)


def _decaying(height: float, frequency: float, decay: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda t: height * np.exp(-t / decay) * np.sin(2.0 * math.pi * frequency * t)


def _stated() -> list[tuple[str, Callable[[np.ndarray], np.ndarray]]]:
    """Pulses and decaying sines, small and large."""
    found: list[tuple[str, Callable[[np.ndarray], np.ndarray]]] = []
    for degrees, seconds in ((10, 0.5), (10, 2.0), (90, 0.5), (90, 2.0), (180, 0.5)):
        found.append((f"pulse of {degrees}°, {seconds:g} s", _pulse(math.radians(degrees), seconds)))
    for degrees, hertz in ((10, 0.25), (10, 0.5), (90, 0.25), (90, 0.5), (90, 1.0)):
        wave = _decaying(math.radians(degrees), hertz, 3.0)
        found.append((f"sine of {degrees}°, {hertz:g} Hz, decaying in 3 s", wave))
    return found


def _searched(runs: GainBench) -> list[Named]:
    """The worst disturbance found for each energy, each search begun from the last; up to where the loop diverges."""
    t, found = runs.times, []
    d: Any = _decaying(1.0, 0.3, 5.0)(t)
    for energy in ENERGIES:
        d = runs.worst(d, energy, TURNS if found else FIRST_TURNS)
        if d is None:
            found.append((f"worst found, ∫|d|² = {energy:g}", Attained(math.inf, energy, math.inf)))
            break
        found.append((f"worst found, ∫|d|² = {energy:g}", runs.attained(runs.held(d))))
    return found


# What is shown --------------------------------------------------------------------------------------
def _evidence(bench: PaperBench, largest: float, stated: list[Named], worst: list[Named]) -> str:
    tame = max((a.gain for _, a in stated if a.reach <= RANGE), default=math.inf)
    if not math.isfinite(max(tame, largest)):
        return f"γ = {bench.gamma:.1f}, γ* = {bench.gamma_star:.1f}: the loop diverges under most disturbances tried."
    text = (
        f"γ = {bench.gamma:.1f}, γ* = {bench.gamma_star:.1f}. With |x1| ≤ 180° pulses and decaying sines attain up to "
        f"{tame:.1f}, the worst disturbances found up to {largest:.1f}: {largest / bench.gamma:.3f} γ, "
        f"{largest / bench.gamma_star:.3f} γ*."
    )
    beyond = [a for _, a in (*stated, *worst) if a.gain > bench.gamma and a.reach > RANGE]
    if not beyond:
        return f"{text} Nothing tried exceeds γ, within {HORIZON:g} s."
    first = min(beyond, key=lambda a: a.energy if math.isfinite(a.energy) else math.inf)
    gain = "diverges" if math.isinf(first.gain) else f"attains {first.gain:.1f}"
    reach = "" if math.isinf(first.reach) else f", with |x1| up to {math.degrees(first.reach):.0f}°"
    return f"{text} Eq. (5) is local: with ∫|d|² = {first.energy:.3g} rad² s the loop {gain}{reach}."


def _table(bench: PaperBench, stated: list[Named], worst: list[Named]) -> Table:
    rows = []
    for name, a in (*stated, *worst):
        known = math.isfinite(a.gain)
        energy = a.energy if math.isfinite(a.energy) else None
        reach = math.degrees(a.reach) if math.isfinite(a.reach) else None
        shares = (a.gain, a.gain / bench.gamma, a.gain / bench.gamma_star) if known else (None, None, None)
        rows.append((name, energy, reach, *shares))
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
def _figure(bench: PaperBench, worst: list[Named]) -> Figure:
    figure, (axes,) = new_figure(height=3.0)
    known = [a for _, a in worst if math.isfinite(a.gain)]
    inside, outside = ([a for a in known if (a.reach <= RANGE) == within] for within in (True, False))
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
    axes.axhline(bench.gamma, color=SERIES[1], linewidth=1.4, label="γ of the design")
    axes.axhline(bench.gamma_star, color=MUTED, linewidth=1.2, linestyle=(0, (4.0, 2.2)), label="γ*")
    axes.set_xscale("log")
    axes.set_xlim(0.7 * ENERGIES[0], 1.4 * ENERGIES[-1])
    axes.set_ylim(0.0, None)
    axes.set_xlabel("energy of the disturbance, ∫|d|² (rad² s)")
    label(axes, "attained gain", "")
    legend(axes)
    caption = (
        "The largest √(∫|z|²/∫|d|²) found by ascent on the disturbance, from below, against the γ that the design "
        "guarantees near rest, from above."
    )
    return Figure("figure-gain", figure_to_svg(figure), caption)
