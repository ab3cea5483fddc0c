"""Bounds of states: what they are, and the nearest mean within them.

Estimators that take bounds have one method, *projection*: after every prediction and every correction, a mean outside
of its bounds moves to the most likely point within, and the covariance stays.

- The extended filter projects along its own P, in both forms.
- A filter with a constant gain projects along the P that its errors have after very many samples, with that gain.
- The unscented filter has its likely points at hand and clips those, before the plant moves them and before they are
  measured, and then the mean [kandepu2008]: no point of the plant or of a sensor is evaluated out of bounds.
- The output-injection observer and the filter of a workspace refuse bounds: the error of the first one is linear
  exactly, which a projection would end, and the second one has no covariance of the states at a pose.

A belief with a mean x̂ outside of its bounds has its most likely point within them at

    min (x − x̂)ᵀ P⁻¹ (x − x̂),  low ≤ x ≤ high,

which moves the states without bounds too, as far as they go together with the others [simon2010]. Of one bound that is
met this is x̂ + P eᵢ (b − x̂ᵢ) / Pᵢᵢ: the bound as a measurement without noise. Of several, `projected` takes them one
after the other, the one first that is most deviations away, and each moves the mean along what is left of P once those
before hold. So it ends after as many turns as there are bounds, within all of them. It is the minimum above where none
of these bounds would have to be let go again; otherwise a point near to it. P stays: a variance that were cut off with
the density would never grow back.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.errors import InvalidInput
from flexhinf.plant import Plant
from flexhinf.scalars import clip, where
from flexhinf.validation import checked_kind, real_array, value_text

#: Names and intervals (low, high) of states.
Bounds = dict[str, tuple[float, float]]

#: What is left of a variance below this part of it is rounding: other bounds hold this state too.
HELD = 1e-12


def checked_bounds(bounds: Mapping[str, tuple[float, float]] | None, plant: Plant) -> Bounds:
    """Intervals of states, none for None.

    Raises InvalidInput: for what is no mapping, an unknown state, or what is no interval.
    """
    what, advice = "The bounds of the estimates are no mapping.", "bounds={'stiffness': (0.5, 2.0)}"
    checked_kind(what, {} if bounds is None else bounds, Mapping, "(low, high) by name", advice)
    checked: Bounds = {}
    for name, interval in (bounds or {}).items():
        plant.index(name)
        try:
            low, high = real_array(interval).tolist()
        except (TypeError, ValueError):
            low = high = np.nan
        if not low < high:
            raise InvalidInput(
                f"The bounds of {name!r} are not an interval.",
                f"expected (low, high) with low < high, got {value_text(interval)}",
                f"bounds={{{name!r}: (-1.0, 1.0)}}",
            )
        checked[name] = (low, high)
    return checked


def bounded_places(bounds: Bounds, plant: Plant) -> tuple[list[int], list[tuple[float, float]]]:
    """Places of the states with bounds, in the order of their names, and their intervals."""
    names = sorted(bounds)
    return [plant.index(name) for name in names], [bounds[name] for name in names]


def check_inside(mean: np.ndarray, bounds: Bounds, plant: Plant) -> None:
    """Refuse a mean (n,) outside of the bounds."""
    for name, (low, high) in bounds.items():
        at = mean[plant.index(name)]
        if not low <= at <= high:
            raise InvalidInput(
                f"The mean is outside the bounds of {name!r}.",
                f"expected {low:.6g} to {high:.6g}, got {at:.6g}",
                "wider bounds, or another mean",
            )


def projected(
    places: list[int], ends: list[tuple[float, float]], mean: Elements, columns: Elements
) -> Elements:
    """The mean (n,) within intervals (k,) of the states at some places, along the columns (n, k) of P there."""
    mean, columns = np.array(mean), np.array(columns)
    own = [columns[place, k] for k, place in enumerate(places)]
    for _ in places:
        farthest, gap, variance, along = 0.0, 0.0, 1.0, 0.0 * mean
        for k, (place, (low, high)) in enumerate(zip(places, ends, strict=True)):
            left, away = columns[place, k], clip(mean[place], low, high) - mean[place]
            free = left > HELD * own[k]
            size = where(free, away * away / where(free, left, 1.0), 0.0)
            more = size > farthest
            farthest, gap = where(more, size, farthest), where(more, away, gap)
            variance, along = where(more, left, variance), where(more, columns[:, k], along)
        gain = along / variance
        mean = mean + gain * gap
        columns = columns - np.outer(gain, along[places])
    for place, (low, high) in zip(places, ends, strict=True):  # to the last digit, and what is known exactly
        mean[place] = clip(mean[place], low, high)
    return mean
