"""Beliefs of the filters, by their form."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.estimation.square_root import (
    RootGaussian,
)
from flexhinf.validation import (
    read_only,
)

#: Reciprocal condition before the first correction.
WELL = read_only(np.ones(1))


class FilterGaussian(NamedTuple):
    """A mean (n,), a covariance (n, n), and the reciprocal condition (1,) of the last prediction and correction: 0
    where a pivot of the covariance was zero to rounding, and taken for zero, else 1."""

    mean: Elements
    covariance: Elements
    rcond: Elements = WELL


class FilterRootGaussian(NamedTuple):
    """A mean (n,), rows W (n, n) of deviations, P = WᵀW, and the reciprocal condition (1,) of the last correction, see
    `flexhinf.estimation.square_root.reciprocal_condition`."""

    mean: Elements
    root: Elements
    rcond: Elements = WELL

    covariance = RootGaussian.covariance


class GatedGaussian(NamedTuple):
    """As `FilterGaussian`, and how often each element of a measurement was rejected (p,)."""

    mean: Elements
    covariance: Elements
    rejected: Elements
    rcond: Elements = WELL


class GatedRootGaussian(NamedTuple):
    """As `FilterRootGaussian`, and how often each element of a measurement was rejected (p,)."""

    mean: Elements
    root: Elements
    rejected: Elements
    rcond: Elements = WELL

    covariance = RootGaussian.covariance


#: Beliefs of filters by form, and whether there is a gate.
BELIEFS: dict[tuple[str, bool], type] = {
    ("covariance", False): FilterGaussian,
    ("covariance", True): GatedGaussian,
    ("square_root", False): FilterRootGaussian,
    ("square_root", True): GatedRootGaussian,
}
