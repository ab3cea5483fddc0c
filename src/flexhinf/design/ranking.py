"""Which of the tuned laws are ranked, the best rival of nonlinear H∞, and where each law is in its trade-off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from flexhinf.design.criterion import Criterion, Figures, pareto_front, unstable_corners
from flexhinf.design.laws import DESIGN, NL_HINF
from flexhinf.design.tuning import TunedLaw


def is_ours(name: str) -> bool:
    """Whether a law is the design's own, or nonlinear H∞ tuned; linear H∞ (hinf) is a rival of it."""
    return name in (DESIGN, NL_HINF) or name.startswith(f"{NL_HINF}-")


def ranked(laws: Sequence[TunedLaw]) -> list[TunedLaw]:
    """Laws with no more unstable corners of the tolerances than the design, by the criterion; the design itself is no
    side of the comparison."""
    design = next((law for law in laws if law.name == DESIGN), None)
    allowed = 0 if design is None else unstable_corners(design.evaluation)
    found = (law for law in laws if law.name != DESIGN and law.feasible)
    return sorted((x for x in found if unstable_corners(x.evaluation) <= allowed), key=lambda law: law.cost)


def best_rival(laws: Sequence[TunedLaw]) -> TunedLaw | None:
    """The first of `ranked` that is not nonlinear H∞; None if there is none."""
    return next((law for law in ranked(laws) if not is_ours(law.name)), None)


@dataclass(frozen=True)
class TradeOff:
    """Where a law is between what it costs and what it holds.

    Attributes
    ----------
    point : Figures
        Of the law as it was tuned.
    curve : tuple of Figures
        Load deviation against peak input, by rising peak input: the best of all candidates that were tried and keep the
        limits of the linear loop. Of the design's own law only its point.
    """

    name: str
    point: Figures
    curve: tuple[Figures, ...]


def trade_offs(laws: Sequence[TunedLaw], criterion: Criterion) -> tuple[TradeOff, ...]:
    """Peak input against load deviation of every law, as a point and as a curve."""
    return tuple(
        TradeOff(law.name, law.figures, pareto_front((*law.tried, law.figures), criterion)) for law in laws
    )
