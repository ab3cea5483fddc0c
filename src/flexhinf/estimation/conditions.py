"""How many digits the updates of a filter keep, and which elements of a measurement say nothing for want of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from operator import mul

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.plant.protocols import Belief
from flexhinf.scalars import absolute, masked, minimum, where
from flexhinf.scalars.run import Run


def conditioned(
    run: Run,
    belief: Belief,
    function: Callable[..., Elements],
    *arrays: Elements | int,
    goes_on: bool = False,
    known: dict[str, Elements] | None = None,
) -> dict[str, Elements]:
    """What is known of a belief by name, and its next reciprocal condition, from a function of arrays and, where that
    `goes_on`, of the one before; no more than one that is known. Nothing more of a belief without."""
    known = known or {}
    if "rcond" not in belief._fields:
        return known
    rcond = run.call(function, *arrays, *([belief.rcond] if goes_on else []))
    return {**known, "rcond": run.call(lesser, rcond, known["rcond"]) if "rcond" in known else rcond}


def lesser(first: Elements, second: Elements) -> Elements:
    """The smaller one of two numbers, (1,)."""
    return np.array([minimum(first[0], second[0])])


#: Smallest part of an innovation's size squared, times the states and outputs, that is no rounding of its variance.
DEPENDENT = 4e-14


def independent(flags: Elements, spread: Elements, sizes: Elements, n: int) -> Elements:
    """Flags (p,) without elements whose innovation is known exactly, or from those before: where elimination leaves
    nothing of its variance but rounding. For an R^n that is singular; no other leaves so little.

    `spread`: (p, p), covariance of the innovation. `sizes`: (p,), of what it is made of. `n`: number of states.
    """
    p, kept = len(flags), list(flags)
    left = masked(np.array([flags * flag for flag in flags]), np.array(spread))
    for k in range(p):
        own = left[k, k] > DEPENDENT * (n + p) * sizes[k] * sizes[k]
        kept[k] = where(own, flags[k], 0.0)
        inverse = kept[k] / where(own, left[k, k], 1.0)
        left = left - np.array([left[:, k] * (entry * inverse) for entry in left[:, k]])
    return np.array(kept)


#: Part of a mean that counts as a deviation: times √`DEPENDENT`, 18 eps, which rounding of sigma points may spread.
SPREAD = 2e-8


def covariance_scales(covariance: Elements, slope: Elements, noise: Elements, mean: Elements) -> Elements:
    """Likewise, from P and the mean; see `flexhinf.estimation.square_root.innovation_scales`."""
    deviations = np.sqrt(absolute(np.diagonal(covariance))) + SPREAD * absolute(mean)
    return absolute(slope) @ deviations + np.sqrt(np.diagonal(noise))


def pivots_kept(root: Elements, covariance: Elements, *before: Elements) -> Elements:
    """0 (1,) where a pivot of a covariance (n, n) was zero to rounding, and taken for zero in its Cholesky factor, else
    1; times what it was `before` (1,), from 0 to 1."""
    pairs = zip(np.diagonal(root), np.diagonal(covariance), strict=True)
    kept = [where(pivot > 0.0, 1.0, where(variance > 0.0, 0.0, 1.0)) for pivot, variance in pairs]
    return np.array([reduce(mul, kept, *(one[0] for one in before))])
