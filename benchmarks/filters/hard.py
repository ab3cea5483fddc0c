"""Hard linear filters, counted for each method: right, wrong with a sign, silently wrong, not finite, raised.

A method is right where means are within 1e-3 standard deviations and variances within 1e-3 at every sample that is
compared with the Kalman filter in 600 bits. Methods that ask for F get that of 600 bits, rounded to floats; drawn
filters whose answer this rounding moves are left out.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from importlib.metadata import version
from typing import Any

import numpy as np
from fuzz.hostile_filters import (
    CLOSE,
    Case,
    draw,
    error,
    estimates,
    exact,
    filter_of,
    is_determined,
    kept,
    rounded,
)

from benchmarks.filters.others import OTHERS, Dynamax
from flexhinf.estimation.diagnosis import about_numbers

#: Drawn filters: their seed, and how many are drawn.
SEED, DRAWN = 0, 150

#: Ends of a run, in the order of the table.
ENDS = ("right", "flagged", "silent", "not finite", "raised")

#: Ours by name: what `filter_of` is told.
OURS = {
    f"flexhinf, {name}, {form}": {"kind": kind, "form": form.replace(" ", "_")}
    for form in ("square root", "covariance")
    for kind, name in (("ukf", "UnscentedKalmanFilter"), ("ekf", "ExtendedKalmanFilter"))
}

#: Groups of filters, and what the table calls them.
GROUPS = {
    "determined": "kept, all inputs determine the answer",
    "undetermined": "kept, last bits of an input decide",
    "drawn": "drawn, all inputs determine the answer",
}


def groups() -> Iterator[tuple[str, Case, tuple[np.ndarray, np.ndarray]]]:
    """Cases with their answers, and F and g in floats."""
    for case in kept():
        estimator = filter_of(case)
        yield (
            "determined" if case.determined else "undetermined",
            case,
            rounded(case, estimator.sub_steps, estimator.stages),
        )
    for attempt in range(DRAWN):
        rng = np.random.default_rng([SEED, attempt])
        case = draw(rng)
        estimator = filter_of(case)
        steps = estimator.sub_steps, estimator.stages
        answered, floats = exact(case, *steps), rounded(case, *steps)
        if not is_determined(answered, *steps, rng):
            continue
        other = exact(case, *steps, floats)
        if error(answered, other.mean, other.variance) <= CLOSE:
            yield "drawn", answered, floats


def end_of(case: Case, run: Callable[[], Any], flagged: Callable[[], bool] = lambda: False) -> str:
    """How a run of a filter ends: one of `ENDS`."""
    try:
        with warnings.catch_warnings(action="ignore"), np.errstate(all="ignore"):
            means, variances = run()
    except Exception:
        return "raised"
    if not (np.isfinite(means).all() and np.isfinite(variances).all()):
        return "not finite"
    if error(case, means, variances) <= CLOSE:
        return "right"
    return "flagged" if flagged() else "silent"


def ends(case: Case, floats: tuple[np.ndarray, np.ndarray], dynamax: Dynamax | None) -> dict[str, str]:
    """How every method ends on a case, by its name."""
    found = {}
    for name, told in OURS.items():
        estimator = filter_of(case, **told)
        found[name] = end_of(
            case,
            lambda estimator=estimator: estimates(case, estimator),
            lambda estimator=estimator: bool(about_numbers(estimator.diagnosis)),
        )
    for name, kind in OTHERS.items():
        found[name] = end_of(case, lambda kind=kind: estimates(case, kind(case, *floats)))
    for name, both in (dynamax.estimates(case, *floats) if dynamax else {}).items():
        found[f"Dynamax, {name}"] = end_of(case, lambda both=both: both)
    return found


def counted() -> dict[str, Any]:
    """Rows of the table, and versions of the libraries."""
    dynamax = Dynamax() if Dynamax.there() else None
    counts: dict[tuple[str, str], Counter[str]] = {}
    for k, (group, case, floats) in enumerate(groups()):
        for name, end in ends(case, floats, dynamax).items():
            counts.setdefault((name, group), Counter())[end] += 1
        if k % 20 == 19:
            print(f"{k + 1} filters", flush=True)
    if dynamax:
        dynamax.close()
    versions = {name: version(name) for name in ("numpy", "filterpy")} | (dynamax.version if dynamax else {})
    rows = [
        {"method": name, "group": group, **{end: count[end] for end in ENDS}}
        for (name, group), count in counts.items()
    ]
    return {"seed": SEED, "drawn": DRAWN, "versions": versions, "rows": rows}


def table(found: dict[str, Any]) -> str:
    """The table of ``docs/estimators_accuracy.md``."""
    rows, lines = found["rows"], []
    methods = dict.fromkeys(row["method"] for row in rows)
    for group, title in GROUPS.items():
        of_group = {row["method"]: row for row in rows if row["group"] == group}
        total = sum(next(iter(of_group.values()))[end] for end in ENDS)
        lines += [
            "", f"**{total} filters, {title}**", "",
            "| | right to 1e-3 | wrong, and says so | silently wrong | not finite | raises |",
            "|---|---:|---:|---:|---:|---:|",
            *(f"| {name} | " + " | ".join(str(of_group[name][end]) for end in ENDS) + " |" for name in methods),
        ]  # fmt: skip
    versions = ", ".join(f"{name} {number}" for name, number in found["versions"].items())
    return "\n".join(
        [*lines, "", f"Drawn with seed {found['seed']}, {found['drawn']} attempts; {versions}."]
    ).strip()
