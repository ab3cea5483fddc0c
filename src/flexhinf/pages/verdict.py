"""The verdict of a comparison: the best rival against nonlinear H∞, both tuned alike."""

from __future__ import annotations

from collections.abc import Sequence

from flexhinf.design.criterion import RATIOS, unstable_corners
from flexhinf.design.laws import DESIGN
from flexhinf.design.result import Comparison
from flexhinf.design.tuning import TunedLaw, best_rival, is_hinf, ranked
from flexhinf.report import number

#: Differences of the criterion smaller than this fraction say nothing: two searches of one law end so far apart.
EQUAL = 0.1


def tuned_laws(comparison: Comparison) -> list[TunedLaw]:
    """Every law that is compared, the design's own first."""
    return [row.tuned for row in comparison.compared if row.tuned is not None]


def rival_of(comparison: Comparison) -> TunedLaw | None:
    """The best rival by the criterion; None where no other law keeps every limit."""
    return best_rival(tuned_laws(comparison))


def ours_of(comparison: Comparison) -> TunedLaw:
    """What the rivals are compared with: the best nonlinear H∞ law tuned as they are; the design as it is where that
    keeps no limit, or is worse."""
    design = comparison.own.tuned
    assert design is not None
    return min(
        [*(law for law in ranked(tuned_laws(comparison)) if is_hinf(law.name)), design],
        key=lambda law: law.cost,
    )


def comparison_verdict(comparison: Comparison) -> str:
    """The best rival against nonlinear H∞, both tuned alike; where ours loses, the first sentence says so."""
    rival, ours = rival_of(comparison), ours_of(comparison)
    if all(is_hinf(row.name) for row in comparison.rows):
        return f"No other law could be compared with {called(ours)}."
    if rival is None:
        others = [law for law in tuned_laws(comparison) if not is_hinf(law.name)]
        return (
            "No other law keeps every limit with at most as many unstable corners as the design, so none is ranked "
            f"against {called(ours)}.{_closest(comparison, others)}"
        )
    sentences = (
        _outcome(rival, ours),
        _second(comparison, rival, ours),
        _ratios_text(comparison, rival, ours),
        _design_text(comparison, ours),
    )
    return " ".join(sentence for sentence in sentences if sentence)


def called(law: TunedLaw) -> str:
    """A law in a sentence."""
    return "the design" if law.name == DESIGN else law.name


def _design_text(comparison: Comparison, ours: TunedLaw) -> str:
    """Where the design itself stands, unless it is already the one that is compared."""
    design = comparison.own.tuned
    if design is None or ours is design:
        return ""
    return f"The design as it is, not tuned for the criterion, has {number(design.cost, 3)}."


def _outcome(rival: TunedLaw, ours: TunedLaw) -> str:
    """Best rival, who is better, and what nonlinear H∞ is worth by the criterion."""
    costs = f"{number(rival.cost, 3)} against {number(ours.cost, 3)}; less is better"
    nothing = "so by this criterion nonlinear H∞ buys nothing on this robot."
    if rival.cost < ours.cost * (1.0 - EQUAL):
        return f"The best rival, {rival.name}, beats {called(ours)} by the criterion ({costs}), {nothing}"
    if rival.cost <= ours.cost * (1.0 + EQUAL):
        return (
            f"Between the best rival, {rival.name}, and {called(ours)} there is no difference that the search can "
            f"tell ({costs}), {nothing}"
        )
    return f"The best rival, {rival.name}, loses to {called(ours)} by the criterion ({costs})."


def _ratios_text(comparison: Comparison, rival: TunedLaw, ours: TunedLaw) -> str:
    """The parts of the criterion of the best rival."""
    ratios = comparison.criterion.ratios
    theirs, mine = ratios(rival.metrics), ratios(ours.metrics)
    parts = [f"{number(theirs[name] / mine[name], 3)} times the {text}" for name, text in RATIOS.items()]
    return f"Relative to {called(ours)}, {rival.name} has {', '.join(parts[:-1])} and {parts[-1]}."


def _second(comparison: Comparison, rival: TunedLaw, ours: TunedLaw) -> str:
    """Other laws that keep every limit and beat nonlinear H∞."""
    better = [
        law for law in ranked(tuned_laws(comparison))
        if law is not rival and not is_hinf(law.name) and law.cost < ours.cost * (1.0 - EQUAL)
    ]  # fmt: skip
    if not better:
        return ""
    names = ", ".join(f"{law.name} ({number(law.cost, 3)})" for law in better[:3])
    return f"Better than {called(ours)} {'is' if len(better) == 1 else 'are'} also {names}."


def _closest(comparison: Comparison, others: Sequence[TunedLaw]) -> str:
    """The law with the smallest criterion, and why it is not ranked; empty where none is compared."""
    own = comparison.own.evaluation
    if not others or own is None:
        return ""
    law = min(others, key=lambda law: law.cost)
    return (
        f" The smallest criterion has {law.name} ({number(law.cost, 3)}), with {unstable_corners(law.evaluation)} "
        f"unstable corners against {unstable_corners(own)}."
    )
