"""The tiles above the figures: the verdict, and the numbers that matter, each with its rivals."""

from __future__ import annotations

import math
from typing import NamedTuple

from flexhinf.designs.requirements import Requirement
from flexhinf.numerals import number, number_text
from flexhinf.studio.preview import Band, LinearParts, Nominal


class Tile(NamedTuple):
    """A number, what stands beside it, and whether it keeps its requirement; None where that is open."""

    number: str
    beside: str = ""
    good: bool | None = None


#: Tiles by key, in order, with their labels.
TILES = {
    "verdict": "Requirements",
    "settling": "Settling time",
    "overshoot": "Overshoot",
    "peak": "Peak input",
    "sensitivity": "Peak sensitivity |S|",
    "unstable": "Robots that fail",
}


def tiles_of(nominal: Nominal, band: Band | None, linear: LinearParts | None) -> dict[str, Tile]:
    """All tiles of what has been computed so far."""
    lines = [
        *nominal.requirements,
        *(band.requirements if band else ()),
        *(linear.requirements if linear else ()),
    ]
    step, second = nominal.step, linear and linear.step
    samples = None if band is None else band.samples
    worst = (
        {}
        if samples is None
        else {
            "settling": float(samples.settling.max()),
            "overshoot": float(samples.overshoot.max()),
            "peak": float(samples.peak.max()),
        }
    )
    unit = nominal.setup.limits.effort_units[0]

    def numbers(key: str, value: float, other: float | None, unit: str) -> Tile:
        beside = [] if second is None or other is None else [f"linear law {_joined(other, unit)}"]
        if key in worst and samples is not None:
            beside.append(f"worst of {len(samples)} {_joined(worst[key], unit)}")
        return Tile(_text(value, unit), "\n".join(beside), _kept(lines, key))

    return {
        "verdict": _verdict(lines, complete=band is not None and linear is not None),
        "settling": numbers("settling", step.settling.value, second and second.settling.value, "s"),
        "overshoot": numbers("overshoot", step.overshoot.value, second and second.overshoot.value, "%"),
        "peak": numbers("peak", step.peak_input, second and second.peak_input, unit),
        "sensitivity": _sensitivity(linear, lines),
        "unstable": _unstable(band),
    }


def _text(value: float, unit: str) -> str:
    return (
        number_text(value, unit, 3)
        if math.isfinite(value)
        else ("not settled" if unit == "s" else "diverges")
    )


def _joined(value: float, unit: str) -> str:
    return _text(value, unit).replace(" ", "\N{NO-BREAK SPACE}")


def _kept(lines: list[Requirement], key: str) -> bool | None:
    fields = {"overshoot": "overshoot", "peak": "peak_effort"}
    judged = [line.met for line in lines if line.field == fields.get(key, "-")]
    return all(judged) if judged else None


def _verdict(lines: list[Requirement], complete: bool) -> Tile:
    missed = [line for line in lines if line.missed]
    names = ", ".join(dict.fromkeys(line.what for line in missed))
    if missed:
        return Tile(f"{len(missed)} of {len(lines)} not met", names, False)
    if not complete:
        return Tile("…", f"{len(lines)} met so far")
    return Tile("met", f"all {len(lines)} of step, band and margins; flexhinf design judges more", True)


def _sensitivity(linear: LinearParts | None, lines: list[Requirement]) -> Tile:
    if linear is None:
        return Tile("…")
    if linear.failure:
        return Tile("none", "no equilibrium", False)
    margins = linear.nominal.evaluation.margins
    if not margins.stable:
        return Tile("unstable", "the nominal loop", False)
    s = linear.nominal.setup.specification
    delay = _joined(1e3 * margins.delay_margin_s, "ms")
    beside = f"limit {s.limit('peak_sensitivity'):g}\ngain margin × {number(margins.gain_margin, 3)}, delay {delay}"
    kept = [line.met for line in lines if line.field in ("peak_sensitivity", "gain_margin", "delay_margin")]
    return Tile(number(margins.peak_sensitivity, 3), beside, all(kept))


def _unstable(band: Band | None) -> Tile:
    if band is None:
        return Tile("…")
    if band.samples is None:
        return Tile("none", "no tolerances, or no robots")
    count, lost, failed = len(band.samples), band.samples.diverged, band.samples.unsettled
    return Tile(
        f"{failed} of {count}", f"unstable: {lost}\nstable, but not settled: {failed - lost}", failed == 0
    )
