"""What a comparison comes to: one row per law."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.design.compare.linear import Linear
from flexhinf.design.compare.names import REFERENCE, Kind
from flexhinf.design.compare.reference import Reference
from flexhinf.design.compare.tuned import Target, Tuned
from flexhinf.design.disturbed import Disturbed
from flexhinf.design.move import Move
from flexhinf.design.response import Response

__all__ = ["Comparison", "Drawn", "Row", "Runs"]


@dataclass(frozen=True, eq=False)
class Drawn:
    """Step and move of robots within their tolerances; infinite where a run diverged or did not settle.

    Attributes
    ----------
    overshoot, settling, peak, move_error : (N,)
        Per cent, s, V or N·m, rad or m; the worst of the joints.
    """

    overshoot: np.ndarray
    settling: np.ndarray
    peak: np.ndarray
    move_error: np.ndarray

    @staticmethod
    def of(runs: Sequence[tuple[Response, Move]]) -> Drawn | None:
        """The figures of some runs; None without any."""
        if not runs:
            return None
        rows = [(*step_figures(step), move_figures(move)[0]) for step, move in runs]
        peak, overshoot, settling, error = np.array(rows).T
        return Drawn(overshoot, settling, peak, error)


@dataclass(frozen=True, eq=False)
class Runs:
    """The nominal runs of a law.

    Attributes
    ----------
    step : Response
        The goal commanded at once, as the law is commanded.
    raw : Response or None
        The same with integrals at zero; None for a law without integrals, whose step is that.
    loaded : Disturbed
    move : Move
    """

    step: Response
    raw: Response | None
    loaded: Disturbed
    move: Move


@dataclass(frozen=True, eq=False)
class Row:
    """One law.

    Attributes
    ----------
    kind : Kind
    tuned : Tuned or None
        None where no law could be made: then there is nothing but `failure`.
    runs : Runs or None
    drawn : Drawn or None
    linear : Linear or None
        None where the loop could not be linearised: `linear_failure` says why.
    operations : int
    needs : tuple of str
        States that the law depends on.
    failure, linear_failure : str
    """

    kind: Kind
    tuned: Tuned | None = None
    runs: Runs | None = None
    drawn: Drawn | None = None
    linear: Linear | None = None
    operations: int = 0
    needs: tuple[str, ...] = ()
    failure: str = ""
    linear_failure: str = ""

    @property
    def name(self) -> str:
        """Of the law."""
        return self.kind.name

    @cached_property
    def figures(self) -> Mapping[str, float | None]:
        """Figures of merit by `flexhinf.design.compare.merits.Merit.key`; None where there is none, SI units.

        Infinite: a run diverged, a step did not settle in its time, or a loop is unstable.
        """
        from flexhinf.design.compare.merits import MERITS

        found: dict[str, float | None] = {merit.key: None for merit in MERITS}
        if self.runs is None:
            return found
        found |= _named("step", step_figures(self.runs.step))
        if self.runs.raw is not None:
            found |= _named("raw", step_figures(self.runs.raw))
        found["load_deviation"], found["load_remaining"] = load_figures(self.runs.loaded)
        found["move_error"], found["move_peak_input"] = move_figures(self.runs.move)
        if self.drawn is not None:
            found |= _drawn_figures(self.drawn)
        if self.linear is not None:
            found |= _linear_figures(self.linear)
        found["operations"] = float(self.operations)
        return found


@dataclass(frozen=True, eq=False)
class Comparison:
    """Laws on the same loop.

    Attributes
    ----------
    reference : Reference
        The design that the others are tuned to.
    target : Target
    rows : tuple of Row
        The reference first.
    drawn : tuple of mapping
        Parameters of the robots within their tolerances: the same for all laws.
    sub_steps : int
        Runge–Kutta steps per period of the true plant: the same for all.
    """

    reference: Reference
    target: Target
    rows: tuple[Row, ...]
    drawn: tuple[Mapping[str, Any], ...]
    sub_steps: int

    @property
    def compared(self) -> tuple[Row, ...]:
        """Rows of laws that could be made."""
        return tuple(row for row in self.rows if row.runs is not None)

    @property
    def first(self) -> Row:
        """The reference's row."""
        return self.rows[0]

    def row(self, name: str) -> Row | None:
        """The row of a law that was compared, or None."""
        return next((row for row in self.compared if row.name == name), None)

    @property
    def others(self) -> tuple[Row, ...]:
        """All compared rows but the reference's."""
        return tuple(row for row in self.compared if row.name != REFERENCE)


def step_figures(response: Response) -> tuple[float, float, float]:
    """Peak input, largest overshoot, slowest settling of a step."""
    peak = float(np.abs(response.run.signals["input"]).max())
    if response.diverged is not None:
        return np.inf, np.inf, np.inf
    moved = [m for m in response.metrics if m["overshoot_percent"] is not None]
    times = [np.inf if m["settling_time_s"] is None else m["settling_time_s"] for m in moved]
    return peak, max((m["overshoot_percent"] for m in moved), default=0.0), max(times, default=0.0)


def move_figures(move: Move) -> tuple[float, float]:
    """Largest error of any joint, and peak input."""
    if move.response.diverged is not None:
        return np.inf, np.inf
    return float(np.abs(move.error).max()), float(np.abs(move.response.run.signals["input"]).max())


def load_figures(loaded: Disturbed) -> tuple[float, float]:
    """Largest deviation of any joint, and what is left of it in the last tenth."""
    if loaded.response.diverged is not None:
        return np.inf, np.inf
    rows = loaded.metrics
    return max(m["peak_deviation"] for m in rows), max(m["remaining"] for m in rows)


def _named(kind: str, figures: tuple[float, float, float]) -> dict[str, float]:
    names = (f"{kind}_peak_input", f"{kind}_overshoot_percent", f"{kind}_settling_s")
    return dict(zip(names, figures))


def _drawn_figures(drawn: Drawn) -> dict[str, float]:
    return {
        "drawn_unsettled": float(np.isinf(drawn.settling).sum()),
        "drawn_overshoot_percent": _median(drawn.overshoot),
        "drawn_worst_overshoot_percent": float(drawn.overshoot.max()),
        "drawn_settling_s": _median(drawn.settling),
        "drawn_worst_settling_s": float(drawn.settling.max()),
        "drawn_worst_peak_input": float(drawn.peak.max()),
        "drawn_move_error": _median(drawn.move_error),
        "drawn_worst_move_error": float(drawn.move_error.max()),
    }


def _median(values: np.ndarray) -> float:
    """The upper median: a run of the list, also where some are infinite."""
    return float(np.sort(values)[len(values) // 2])


def _linear_figures(linear: Linear) -> dict[str, float | None]:
    return {
        "damping": linear.damping,
        "delay_margin_s": linear.delay_margin,
        "peak_sensitivity": linear.peak_sensitivity,
        "input_noise": linear.input_noise,
        "bandwidth_rad_s": linear.bandwidth if np.isfinite(linear.bandwidth) else None,
        "unstable_corners": float(linear.unstable) if linear.corners else None,
    }
