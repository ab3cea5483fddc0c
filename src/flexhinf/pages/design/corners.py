"""Corners of the tolerances in the running loop: how many are unstable, which is worst, and over the noise assumed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from flexhinf.analysis import GrowthRates, ToleranceCorners
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.result import Design
from flexhinf.pages.drawing import changes_text, count_text
from flexhinf.report import Paragraph, Table, number


class CornerRow(NamedTuple):
    """One choice of R^v, or the true state fed back.

    Attributes
    ----------
    form : str
        "as designed", "true state", or the form of R^v.
    ratio : float or None
        q / R^n, of the forms.
    unstable : int
        Corners.
    percent : float
        Of the corners that were computed with this choice.
    rate : float
        Growth rate of the worst corner, 1/s; negative where it decays.
    """

    form: str
    ratio: float | None
    unstable: int
    percent: float
    rate: float


def blocks(design: Design) -> list[Any]:
    """How many corners are unstable; none for a robot without tolerances."""
    e = design.evaluation
    if e.corners is None:
        return []
    found: list[Any] = [Paragraph(corners_text(e)), Paragraph(_how(e.corners))]
    return [*found, Paragraph(_retuning(e.corners)), _table(e.corners)] if e.corners.swept else found


def remarks(design: Design) -> Iterator[str]:
    """Corners that are unstable as designed."""
    e, robust = design.evaluation, design.design_problem.preset == "robust"
    found = e.corners
    if found is None:
        return
    preset = "" if robust else ", or --preset robust"
    if found.unstable:
        state = e.state_corners
        itself = state is not None and state.unstable > 0
        advice = (
            f"the law itself does not stand them: try a shorter --period or --delay, less --bandwidth{preset}"
            if itself
            else f"the estimator causes it: try another --torque-noise or --estimator{preset}"
        )
        yield (
            f"{found.unstable} of {found.count} corners of the tolerances are unstable with this estimator; {advice}."
        )


def corners_text(e: LawEvaluation) -> str:
    """How many corners are unstable as designed, and the worst of them."""
    found = e.corners
    assert found is not None
    which = "" if found.complete else "sampled "
    verb = "is" if found.unstable == 1 else "are"
    unstable = f"{found.unstable} of {found.count} {which}corners {verb} unstable"
    if not found.unstable:
        unstable = f"None of the {found.count} {which}corners is unstable"
    state = e.state_corners
    other = ""
    if state is not None and e.setup.specification.estimator != "none":
        other = f"; with the true state fed back {state.unstable}"
    measured = ", ".join(e.setup.specification.measured).replace("_", " ")
    sensors = "true state" if e.setup.specification.estimator == "none" else measured
    worst = changes_text(found.population.values[found.worst], e.setup.robot, e.setup.specification.extras)
    return f"Measured: {sensors}. {unstable}{other}. The worst corner ({worst}) {_grows(found.designed.fastest)}."


def _grows(rate: float) -> str:
    if not np.isfinite(rate):
        return "has no equilibrium at the goal"
    return f"{'grows' if rate >= 0.0 else 'decays'} with {number(abs(rate), 3)} 1/s"


def _how(found: ToleranceCorners) -> str:
    every = "All" if found.complete else "Sampled"
    return (
        f"{every} corners: every uncertain parameter at one end of its tolerance, all of them together, products of "
        "tolerances included. For each the sampled loop at the goal, with estimator and delay, is linearised; robots "
        "between the corners are not covered."
    )


def _retuning(found: ToleranceCorners) -> str:
    """In which directions the noise of the estimator may be changed."""
    free = [f"“{form}”" for form in found.retunable]
    parts = [
        f"with “{form}” at {len(found.stable_ratios(form))} of {count_text(len(found.of_form(form)), 'ratio')} only"
        for form in found.forms
        if form not in found.retunable
    ]
    may = f"With Rᵛ of the form {' or '.join(free)} no corner is unstable at any ratio tried." if free else ""
    some = f" Otherwise that holds {', '.join(parts)}." if parts and free else ""
    if parts and not free:
        some = f"No form keeps every corner stable at all ratios tried: that holds {', '.join(parts)}."
    return (
        "No paper gives Rᵛ, the process noise that the estimator assumes, and the gain of a filter depends only on its "
        f"ratio q/Rⁿ and on where q stands. {may}{some} Forms that are not listed were not tried."
    )


def corner_rows(e: LawEvaluation) -> list[CornerRow]:
    """As designed, with the true state, then every form and ratio of R^v."""
    found = e.corners
    assert found is not None
    rows = [_row("as designed", None, found.designed)]
    if e.setup.specification.estimator == "none":
        rows = [_row("true state", None, found.designed)]
    elif e.state_corners is not None:
        rows.append(_row("true state", None, e.state_corners))
    for form in found.forms:
        rows += [_row(form, ratio, rates) for ratio, rates in found.of_form(form).items()]
    return rows


def _row(form: str, ratio: float | None, rates: GrowthRates) -> CornerRow:
    corners = rates.kinds == "corner"
    count = int((rates.rates[corners] >= 0.0).sum())
    return CornerRow(form, ratio, count, 100.0 * rates.share("corner"), float(rates.rates[corners].max()))


def corner_cells(found: ToleranceCorners) -> list[tuple[str, ...]]:
    """q / R^n, then for each form of R^v the corners that are unstable and the growth rate of the worst."""
    by_form = [found.of_form(form) for form in found.forms]
    ratios = sorted({ratio for rates in by_form for ratio in rates})
    return [
        (_power(ratio), *(text for rates in by_form for text in _cells(rates.get(ratio)))) for ratio in ratios
    ]


def _cells(rates: GrowthRates | None) -> tuple[str, str]:
    if rates is None:
        return "–", "–"
    row = _row("", None, rates)
    share = f"{row.unstable} ({number(row.percent, 2)} %)" if row.unstable else "0"
    return share, number(row.rate, 3) if np.isfinite(row.rate) else "no equilibrium"


def _power(ratio: float) -> str:
    exponent = round(float(np.log10(ratio)))
    return number(10.0**exponent, 1).removeprefix("1·") if abs(exponent) > 3 else number(ratio)


def _table(found: ToleranceCorners) -> Table:
    columns = (
        "q/Rⁿ",
        *(text for form in found.forms for text in (f"{form}: unstable", "fastest growth, 1/s")),
    )
    caption = "Unstable corners over Rᵛ, by the states on which q stands; a negative growth rate decays"
    return Table(columns, corner_cells(found), caption, "table-corners")
