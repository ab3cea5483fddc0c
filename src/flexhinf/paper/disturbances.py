"""Claims on disturbances: the gain of Eq. (5) that runs attain, and torques on the loop at 90°.

In Eq. (5) d is the paper's disturbance, the command in ė = x1 − d, and z = (60 x1, 300 x5, √R2 u); the true state is
fed back, from rest at x(0) = 0. A step command has infinite energy, so Eq. (5) says nothing of it: pulses and decaying
sines are run, and the worst disturbance of several energies is searched for [tierno1997]. What is attained is a lower
bound of the gain. Eq. (5) is a local statement, so what lies beyond ±180° is shown and not judged.

The paper gives neither size nor place nor frequency of its disturbance torques.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis import DisturbanceSearch
from flexhinf.loop import Sine, Step, Trajectory
from flexhinf.paper.claim import Finding, PaperClaim
from flexhinf.paper.loop_setup import (
    CHANNELS,
    FREQUENCY,
    LOAD_DURATION,
    LOAD_FROM,
    TORQUE,
    PaperSetup,
    known,
    load_numbers,
)
from flexhinf.plant import Law
from flexhinf.report import Column, Table

#: Horizon, s: disturbances die out well before, and the response with them.
HORIZON = 20.0
#: Inside this |x1|, rad, gains are judged: the paper's largest command.
RANGE = math.pi
#: Turns of the search for each energy.
TURNS = 12
#: ∫|d|² of the worst disturbances searched for, rad² s.
ENERGIES = (1e-4, 0.1, 1.0, 3.0, 10.0, 20.0, 30.0, 60.0, 100.0)

#: Largest deviation that a sinusoidal torque may cause, rad: 20 % of the command.
LIMIT = 0.20 * math.pi / 2
#: Frequencies of the torque that are shown, Hz; one of them is judged.
FREQUENCIES = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)

#: A disturbance as a function of time, arrays in, arrays out.
Signal = Callable[[np.ndarray], np.ndarray]


# Gain of Eq. (5) -----------------------------------------------------------------------------------------
@dataclass(frozen=True)
class RunGain:
    """One disturbance: √(∫|z|²/∫|d|²), the largest over all horizons, infinite if the run diverged; ∫|d|², rad²·s; and
    the largest |x1|, rad."""

    gain: float
    energy: float
    reach: float

    @property
    def inside(self) -> bool:
        """Whether the link stayed within ±180° of the hanging rest; false for a run that diverged."""
        return self.reach <= RANGE


class GainRuns:
    """Runs of a law's loop under disturbances of Eq. (5)."""

    def __init__(self, setup: PaperSetup, law: Law) -> None:
        self.setup = setup
        self.search = DisturbanceSearch(setup.problem, law, None, setup.settings.period, HORIZON)

    def attained(self, disturbance: Signal) -> RunGain:
        """The gain under a disturbance, held between samples."""
        d = np.asarray(disturbance(self.search.runs.times), dtype=float)
        found = self.search.runs.attained(d[:, None])
        if np.isinf(found.gain):
            return RunGain(np.inf, found.energy, np.inf)
        return RunGain(found.gain, found.energy, float(np.abs(found.trajectory.signals["state"][:, 0]).max()))

    def searched(self) -> dict[str, RunGain]:
        """The worst disturbance found for each energy, each search begun from the last, up to where the loop
        diverges."""
        found: dict[str, RunGain] = {}
        d: Any = self.search.small()[1]  # the worst sinusoid of small motions, (N, 1)
        for energy in ENERGIES:
            d, name = self.search.ascend(d, energy, TURNS), f"worst found, ∫|d|² = {energy:g}"
            if d is None:
                found[name] = RunGain(math.inf, energy, math.inf)
                break
            found[name] = self.attained(lambda t, d=d: self.search.on(t, d[:, 0]))
        return found


def stated_disturbances() -> dict[str, Signal]:
    """Pulses and decaying sines, small and large, by name."""
    found: dict[str, Signal] = {}
    for degrees, seconds in ((10, 0.5), (10, 2.0), (90, 0.5), (90, 2.0), (180, 0.5)):
        name = f"pulse of {degrees}°, {seconds:g} s"
        found[name] = lambda t, d=degrees, s=seconds: np.where(t < s, math.radians(d), 0.0)
    for degrees, hertz in ((10, 0.25), (10, 0.5), (90, 0.25), (90, 0.5), (90, 1.0)):
        name = f"sine of {degrees}°, {hertz:g} Hz, decaying in 3 s"
        found[name] = lambda t, d=degrees, f=hertz: (
            math.radians(d) * np.exp(-t / 3.0) * np.sin(2.0 * math.pi * f * t)
        )
    return found


def attained_gain(setup: PaperSetup) -> Finding:
    """Judge Eq. (5): the largest gain of stated disturbances and of the worst found, within ±180°."""
    runs = GainRuns(setup, setup.nonlinear)
    stated = {name: runs.attained(d) for name, d in stated_disturbances().items()}
    worst = runs.searched()
    found = {**stated, **worst}
    tame, largest = (
        max((run.gain for run in group.values() if run.inside), default=math.inf) for group in (stated, found)
    )
    best = known(largest)
    numbers = {
        "largest_gain": best,
        "largest_gain_over_gamma": best and best / setup.gamma,
        "largest_gain_over_gamma_star": best and best / setup.gamma_star,
    }
    evidence = f"γ = {setup.gamma:.1f}, γ* = {setup.gamma_star:.1f}"
    if best is None or math.isinf(tame):
        evidence += ": the loop diverges under most disturbances tried."
    else:
        local = f"Nothing tried exceeds γ, within {HORIZON:g} s."
        beyond = [run for run in found.values() if run.gain > setup.gamma and not run.inside]
        if beyond:
            first = min(beyond, key=lambda run: run.energy if math.isfinite(run.energy) else math.inf)
            gain = "diverges" if math.isinf(first.gain) else f"attains {first.gain:.1f}"
            reach = "" if math.isinf(first.reach) else f", with |x1| up to {math.degrees(first.reach):.0f}°"
            local = f"Eq. (5) is local: with ∫|d|² = {first.energy:.3g} rad² s the loop {gain}{reach}."
        evidence += (
            f". With |x1| ≤ 180° pulses and decaying sines attain up to {tame:.1f}, the worst disturbances found up to "
            f"{largest:.1f}: {largest / setup.gamma:.3f} γ, {largest / setup.gamma_star:.3f} γ*. {local}"
        )
    rows = []
    for name, run in found.items():
        ratios = (run.gain / setup.gamma, run.gain / setup.gamma_star)
        values = (run.energy, math.degrees(run.reach), run.gain, *ratios)
        rows.append((name, *map(known, values)))
    columns = (
        "disturbance d", Column("∫|d|²", "rad² s"), Column("largest |x1|", "°", 1),
        Column("attained √(∫|z|²/∫|d|²)", "", 1), Column("over γ", "", 3), Column("over γ*", "", 3),
    )  # fmt: skip
    caption = (
        "Attained gain of Eq. (5) from rest, true state fed back, the largest over all horizons up to 20 s."
    )
    table = Table(columns, rows, caption, "table-gain")
    return Finding(largest <= setup.gamma, evidence, (table,), numbers, tuple(worst.values()))


# Torques -------------------------------------------------------------------------------------------------
def _shown(run: Trajectory) -> tuple[float | None, float | None]:
    """Largest deviation in degrees, time of recovery in s."""
    numbers = load_numbers(run)
    peak = numbers["peak_deviation_rad"]
    return None if peak is None else math.degrees(peak), numbers["recovery_time_s"]


def _step_disturbance(setup: PaperSetup) -> Finding:
    found = {c.replace("_torque", ""): _shown(run) for c, run in setup.runs("11").items()}
    fed_back = setup.load_response(setup.nonlinear, Step(TORQUE, at=LOAD_FROM), estimator=None)
    shown = {**found, "link, true state fed back": _shown(fed_back)}
    columns = ("torque at the", Column("largest deviation", "°", 2), Column("time of recovery", "s", 2))
    caption = f"Torque step of {TORQUE:g} N·m; – where the link does not come back or diverges."
    rows = [(name, *values) for name, values in shown.items()]
    table = Table(columns, rows, caption, "table-step-disturbance")
    peaks = [peak for peak, _ in found.values() if peak is not None]
    lost = [name for name, (_, recovery) in found.items() if recovery is None]
    text = f"The link moves by at most {max(peaks, default=math.inf):.1f}°"
    if len(peaks) < len(found):
        text = "The loop diverges."
    elif lost:
        text += f" and is not back within ±2 % at the end with the torque at the {' and the '.join(lost)}."
    else:
        latest = max(recovery for _, recovery in found.values() if recovery is not None)
        text += f" and is back within ±2 % after {latest:.2f} s at the latest."
    return Finding(not lost, text, (table,))


def _stays(run: Trajectory, frequency: float) -> bool:
    """Whether the deviation is small and does not grow: the last two seconds against the two before."""
    peak = load_numbers(run)["peak_deviation_rad"]
    if peak is None or peak > LIMIT:
        return False
    if 2.0 * frequency < 1.0:  # growth can be told from phase only with a whole period in two seconds
        return True
    error = np.abs(run.tracked("link_position") - run.signals["reference"][:, 0])
    last, before = run.time > run.time[-1] - 2.0, run.time > run.time[-1] - 4.0
    return bool(error[last].max() <= 1.05 * error[before & ~last].max() + 1e-4)


def _sine_disturbance(setup: PaperSetup) -> Finding:
    runs = {(FREQUENCY, c): run for c, run in setup.runs("12").items()}
    for f in FREQUENCIES:
        for c in CHANNELS:
            if (f, c) not in runs:
                runs[f, c] = setup.load_response(setup.nonlinear, Sine(TORQUE, f, at=LOAD_FROM), c)
    rows = [(f, *(_shown(runs[f, c])[0] for c in CHANNELS)) for f in FREQUENCIES]
    bad = sorted({f for (f, _), run in runs.items() if not _stays(run, f)})
    peaks = (_shown(runs[FREQUENCY, c])[0] for c in CHANNELS)
    shown = " and ".join("diverged" if peak is None else f"{peak:.1f}°" for peak in peaks)
    others = "It is kept at the other frequencies tried too."
    if bad:
        others = f"The criterion is not kept at {', '.join(f'{f:g}' for f in bad)} Hz."
    text = f"At {FREQUENCY:g} Hz the link moves by at most {shown} (torque at link and at motor). {others}"
    places = (Column(f"torque at the {c}: largest deviation", "°", 2) for c in ("link", "motor"))
    caption = f"Torque of {TORQUE:g} N·m from {LOAD_FROM:g} s on. The paper gives neither size, place nor frequency."
    table = Table((Column("frequency", "Hz", 2), *places), rows, caption, "table-frequencies")
    return Finding(FREQUENCY not in bad, text, (table,))


GAIN = PaperClaim(
    "gain-attained",
    "From rest, ∫|z|² ≤ γ² ∫|d|² for disturbances of finite energy (Eq. 5).",
    "On the nominal arm with the true state fed back, no disturbance tried or found by search that keeps the link "
    "within ±180° of the hanging rest attains √(∫|z|²/∫|d|²) above γ. A search gives a lower bound of the gain and "
    "proves nothing.",
    attained_gain,
)

TORQUES = (
    PaperClaim(
        "withstands-step-disturbance",
        "The loop withstands a step disturbance after a 90° command given at 2 s.",
        f"With a torque step of {TORQUE:g} N·m at {LOAD_FROM:g} s, at the link or at the motor, the link comes back "
        f"within ±2 % of the command's step before {LOAD_DURATION:g} s and stays.",
        _step_disturbance,
        ("figure-11",),
    ),
    PaperClaim(
        "withstands-sine-disturbance",
        "The loop withstands a sinusoidal disturbance after a 90° command given at 2 s.",
        f"With a torque of {TORQUE:g} N·m at {FREQUENCY:g} Hz from {LOAD_FROM:g} s on, at the link or at the motor, "
        "the link stays within 18° (20 % of the command), and the last two seconds deviate at most 5 % more than the "
        "two before.",
        _sine_disturbance,
        ("figure-12",),
    ),
)
