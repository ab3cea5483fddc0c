"""Whether a filter's own numbers fit what a log shows: innovations, NIS, NEES, and how white innovations are.

Of a filter whose model and noises are right, innovations are as large as it says and do not repeat themselves, and the
squared errors over their covariances are χ² [barshalom2001, sections 5.4 and 5.5].
"""

# Distributions of SciPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from flexhinf.errors import refuse_if
from flexhinf.identification.quantisation import autocorrelations, inner, rounding_correlations, smallest_step
from flexhinf.validation import value_text

if TYPE_CHECKING:
    import xarray as xr

#: Confidence of every interval and test, and standard deviations of a band that holds so much of a normal error.
CONFIDENCE, DEVIATIONS = 0.95, 1.959963984540054

#: Most lags of a test, a tenth of the samples at most; a correlation that is smaller is of no consequence, however
#: certain a long log makes it.
LAGS, SMALL_CORRELATION = 20, 0.1

#: Slow changes have so much more power than those of white noise before small correlations are of consequence.
SLOW = 2.0

#: Innovations so much larger or smaller than expected are of no consequence.
SMALL_FACTOR = 1.1

#: A sensor is coarse whose rounding is more than this share of the innovations' standard deviation. Errors of the
#: filter follow its steps too, so that slow changes may have so much more power.
COARSE, SLOW_STEPS = 0.5, 4.0


@dataclass(frozen=True, eq=False)
class Whiteness:
    """Autocorrelations r(1) … r(L) of a sequence, and the test that all of them are zero.

    `correlations`: (L,). `bound`: 95 % of those of white noise are within ± this. `statistic`: Ljung's and Box's,
    χ² with L degrees of freedom for white noise. `p_value`: the probability that it is as large. `rounding`: the part
    of r(1) that the steps of the sensor explain; `correlations` are without it. `slowest`: below this is `slow` of no
    consequence.
    """

    correlations: np.ndarray
    bound: float
    statistic: float
    p_value: float
    rounding: float = 0.0
    slowest: float = SLOW

    @property
    def slow(self) -> float:
        """The power of slow changes beside that of white noise, 1 + 2 Σ r: many small correlations have a large sum."""
        return float(1.0 + 2.0 * self.correlations.sum())

    @property
    def white(self) -> bool:
        """Whether correlations are not certain, or of no consequence: each and all together are small."""
        small = bool(np.abs(self.correlations).max() < SMALL_CORRELATION) and self.slow < self.slowest
        return self.p_value > 1.0 - CONFIDENCE or small


def whiteness(
    values: np.ndarray, lags: int = LAGS, explained: np.ndarray | None = None, slowest: float = SLOW
) -> Whiteness | None:
    """The test of Ljung and Box [ljung1978] on a sequence (N,), whose missing values (NaN) are left out.

    `lags`: at most so many, and at most a tenth of the values. `explained`: (L,) at least, correlations that are known
    to have another cause; they are taken off those of their sign. `slowest`: see `Whiteness`. None for
    fewer than ten values, or constant ones.

    Examples
    --------
    >>> whiteness(np.tile([1.0, -1.0], 50)).correlations[:2].round(2)
    array([-0.99,  0.98])
    """
    from scipy.stats import chi2

    known = values[np.isfinite(values)]
    count = known.size
    centred = known - known.mean() if count else known
    power = inner(centred, centred)
    lags = min(lags, count // 10)
    if lags < 1 or not power > 0.0:
        return None
    seen = autocorrelations(known, lags)
    part = (
        np.zeros(lags)
        if explained is None
        else np.where(seen * explained[:lags] > 0.0, explained[:lags], 0.0)
    )
    correlations = np.sign(seen) * np.maximum(0.0, np.abs(seen) - np.abs(part))
    statistic = float(count * (count + 2) * np.sum(correlations**2 / (count - np.arange(1, lags + 1))))
    return Whiteness(
        correlations,
        DEVIATIONS / float(np.sqrt(count)),
        statistic,
        float(chi2.sf(statistic, lags)),
        float(seen[0] - correlations[0]),
        slowest,
    )


def squared_errors(errors: np.ndarray, covariances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """eᵀ P⁻¹ e (N,) over the elements of errors (N, n) that are no NaN, and how many these are (N,); NaN for none.

    `covariances`: (N, n, n). Of directions in which a covariance is singular nothing is known: such rows are NaN.
    """
    known: np.ndarray = np.isfinite(errors)
    counts, squared = known.sum(axis=1), np.full(len(errors), np.nan)
    for pattern in np.unique(known, axis=0):
        rows = np.flatnonzero((known == pattern).all(axis=1))
        if not pattern.any():
            continue
        part, spread = errors[rows][:, pattern], covariances[rows][:, pattern][:, :, pattern]
        scale = np.sqrt(np.maximum(np.diagonal(spread, axis1=1, axis2=2), 0.0))
        with np.errstate(
            divide="ignore", invalid="ignore"
        ):  # as correlations, of whatever units; singular ones below
            white, related = part / scale, spread / (scale[:, :, None] * scale[:, None, :])
        usable: np.ndarray = np.asarray(
            np.isfinite(related).all(axis=(1, 2)) & np.isfinite(white).all(axis=1)
        )
        usable[usable] = np.linalg.cond(related[usable]) < 1e13
        solved = np.linalg.solve(related[usable], white[usable][:, :, None])[:, :, 0]
        squared[rows[usable]] = np.einsum("ij,ij->i", white[usable], solved)
    return squared, counts


@dataclass(frozen=True, eq=False)
class SquaredError:
    """NIS or NEES of a log over its degrees of freedom, which is 1 in the mean where a filter is consistent.

    `mean`: over all samples. `interval`: (low, high), 95 % of the means of consistent filters, if samples do not
    depend on each other: innovations do not, errors of neighbouring samples do, so that of them the interval is too
    narrow. `samples`: their number. `degrees`: degrees of freedom of all samples together.
    """

    mean: float
    interval: tuple[float, float]
    samples: int
    degrees: int

    @property
    def factor(self) -> float:
        """How many times larger errors are than the filter says: √mean."""
        return float(np.sqrt(self.mean))

    @property
    def judgement(self) -> Literal["as expected", "larger", "smaller"]:
        """Whether errors are as large as the filter says, or differ by what is certain and of consequence."""
        inside = self.interval[0] <= self.mean <= self.interval[1]
        if inside or 1.0 / SMALL_FACTOR < self.factor < SMALL_FACTOR:
            return "as expected"
        return "larger" if self.mean > 1.0 else "smaller"


def squared_error(squared: np.ndarray, degrees: np.ndarray) -> SquaredError | None:
    """`SquaredError` of values (N,), NaN where there is none, with so many degrees of freedom (N,) each."""
    from scipy.stats import chi2

    known = np.isfinite(squared)
    total = int(degrees[known].sum())
    if not total:
        return None
    low, high = chi2.ppf((0.5 - CONFIDENCE / 2.0, 0.5 + CONFIDENCE / 2.0), total) / total
    return SquaredError(
        float(squared[known].sum() / total), (float(low), float(high)), int(known.sum()), total
    )


@dataclass(frozen=True, eq=False)
class OutputConsistency:
    """Innovations of one measured signal, in its unit.

    `samples`: number of measurements. `rms`: root mean square of the innovations. `expected`: median of their standard
    deviations, which the first samples do not move. `factor`: root mean square of innovations over their standard
    deviations, 1 where they are as expected.
    `bias`: mean of the same, 0 where they are. `inside`: share of the innovations in their 95 % bands. `whiteness`: of
    the same, None of too few. `step`: the smallest one between two measurements.
    """

    name: str
    unit: str
    samples: int
    rms: float
    expected: float
    factor: float
    bias: float
    inside: float
    whiteness: Whiteness | None
    step: float = 0.0

    @property
    def coarse(self) -> bool:
        """Whether the steps of the sensor are most of its noise."""
        return _is_coarse(self.step, self.expected)


@dataclass(frozen=True, eq=False)
class Consistency:
    """How well a filter's numbers fit a log: of each measured signal, of all (`nis`), of the true state (`nees`)."""

    outputs: tuple[OutputConsistency, ...]
    nis: SquaredError
    nees: SquaredError | None

    @property
    def correlated(self) -> tuple[OutputConsistency, ...]:
        """Outputs whose innovations are not white."""
        return tuple(each for each in self.outputs if each.whiteness and not each.whiteness.white)

    @property
    def size_fits(self) -> bool:
        """Whether innovations are as large as the filter says; of coarse sensors they may be smaller.

        The error of rounding has its variance q²/12 over all places in a step; at rest it is that of one place.
        """
        judgement = self.nis.judgement
        return judgement == "as expected" or (
            judgement == "smaller" and any(each.coarse for each in self.outputs)
        )

    @property
    def innovations_fit(self) -> bool:
        """Whether innovations are as large as the filter says, and white but for the steps of the sensors."""
        return self.size_fits and not self.correlated

    @property
    def rounded(self) -> bool:
        """Whether innovations follow each other by the steps of the sensors."""
        return any(
            each.whiteness and abs(each.whiteness.rounding) > each.whiteness.bound for each in self.outputs
        )


def consistency(data: xr.Dataset) -> Consistency:
    """What the innovations of `filter_log` say of its filter; with the true state in the log, its errors too.

    Raises InvalidInput: for anything but a table of `filter_log`, and an output without innovations.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> arm = fh.paper_arm()
    >>> ekf = fh.ExtendedKalmanFilter(arm.plant(), 1e-2, 1e-8, 1e-6, np.zeros(4), 1e-4)
    >>> loop = fh.Loop(arm.plant(), fh.Controller(fh.linear_law(arm.problem(), gamma=np.inf), ekf, 1e-2))
    >>> run = loop.run(fh.Sine(0.5, frequency=0.5), noise=1e-3, duration=4.0)
    >>> fh.consistency(fh.filter_log(ekf, run)).outputs[0].name
    'link_position'
    """
    needed = (
        "innovation",
        "innovation_standard_deviation",
        "nis",
        "measured",
        "prediction",
        "output_name",
        "output_unit",
    )
    refuse_if(
        not set(needed) <= {str(name) for name in getattr(data, "variables", ())},
        "This is no table of a filter's innovations.",
        f"expected what filter_log returns, got {value_text(data)}",
        "consistency(filter_log(filter, log))",
    )
    innovations = (
        data[name].values
        for name in ("innovation", "innovation_standard_deviation", "nis", "measured", "prediction")
    )
    nees = squared_error(data["nees"].values, data["known"].values) if "nees" in data else None
    names, units = (data[f"output_{what}"].values.tolist() for what in ("name", "unit"))
    return Consistency(*innovation_consistency(names, units, *innovations), nees)


def innovation_consistency(
    names: Sequence[str],
    units: Sequence[str],
    innovations: np.ndarray,
    deviations: np.ndarray,
    squared: np.ndarray,
    measured: np.ndarray,
    predicted: np.ndarray,
) -> tuple[tuple[OutputConsistency, ...], SquaredError]:
    """What innovations (N, p) with these standard deviations (N, p) say of each output, and their NIS.

    NaN stands where nothing was measured. `squared`: (N,), over their covariance. `measured`: how many are in each.
    `predicted`: (N, p), the outputs that the filter expects.
    """
    with np.errstate(divide="ignore", invalid="ignore"):  # a deviation of zero expects no error at all
        white = innovations / deviations
    outputs: list[OutputConsistency] = []
    for k, (name, unit) in enumerate(zip(names, units)):
        innovation, normal = innovations[:, k], white[:, k]
        known = np.isfinite(normal)
        count = int(known.sum())
        refuse_if(
            not count,
            f"There are no innovations of {name!r}.",
            f"got none in {len(known)} samples",
            "a log that measures it",
        )
        step, expected = smallest_step(predicted[:, k] + innovation), float(np.median(deviations[known, k]))
        explained = (
            rounding_correlations(innovation, predicted[:, k], deviations[:, k], step, LAGS) if step else None
        )
        slowest = SLOW_STEPS if _is_coarse(step, expected) else SLOW
        outputs.append(
            OutputConsistency(
                name,
                str(unit),
                count,
                _rms(innovation[known]),
                expected,
                _rms(normal[known]),
                float(normal[known].mean()),
                float(np.mean(np.abs(normal[known]) <= DEVIATIONS)),
                whiteness(normal, explained=explained, slowest=slowest),
                step,
            )
        )
    nis = squared_error(squared, measured)
    assert nis is not None  # every output has innovations
    return tuple(outputs), nis


def _is_coarse(step: float, expected: float) -> bool:
    return bool(step / np.sqrt(12.0) > COARSE * expected)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
