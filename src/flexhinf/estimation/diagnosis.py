"""What a filter says of answers that cannot be trusted: entries of a kind, a sample, a cure, and a number of samples.

Some linear filters have no answer in floats: moving the last bit of a covariance or of a parameter moves the estimate
by many standard deviations. No algorithm gets those right. These signs tell them from the others:

- online, at each correction of the square-root form: eps/ρ max(1, |ν|), with ρ the smallest pivot of the innovation's
  factor in parts of Σ |c_j| σ_j + √r, what it was made of, and ν the innovation in standard deviations: rounding of W
  moves the mean by so many of them. The belief carries ρ/max(1, |ν|) as `rcond`, in the covariance form 0 where a pivot
  of P was zero to rounding and taken for zero: a controller in Python, a compiled loop and the exported C say and count
  from it when their estimate is in doubt;
- online too, in both forms: innovations that no noise explains, see `innovation_limit`;
- offline, `diagnose`: recorded samples are filtered again with the last bits of one input moved.
"""

# A diagnosis runs copies of a filter from what that keeps.
# pyright: reportPrivateUsage=false

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.errors import refuse_if
from flexhinf.estimation.interface import Filter
from flexhinf.estimation.square_root import root_rows
from flexhinf.plant import CLOSE
from flexhinf.validation import real_array, value_text

EPS = float(np.finfo(float).eps)

#: The first is found when a filter is made, and its cure begins with what was done; the next four are found while it
#: runs, at the first two of them the last belief stays; the others are inputs whose last bits decide.
CURES = {
    "clipped": "state it with more digits, or as the square W'W of its root",
    "not finite": "a shorter period, a smaller initial covariance, or a model that does not diverge",
    "indefinite": 'form="square_root", or a larger process noise',
    "digits": "a larger measurement noise, a smaller initial covariance, or a gate for outliers",
    "innovations": "a gate for outliers, larger noises, a larger initial covariance, or another model",
    "initial covariance": "an initial covariance without zero eigenvalues, or without noise in its last digits",
    "process noise": "a process noise in every direction that is not known exactly",
    "measurement noise": "a larger measurement noise",
    "parameters": "fewer states, units in which they are alike, or outputs that see all of them",
    "measurements": "a larger measurement noise, or a gate for outliers",
}


#: P(χ² ≥ p + 2 √(p t) + 2 t) ≤ exp(−t) with p degrees of freedom [laurent2000, lemma 1]; t of an innovation that no
#: noise explains, some hundred standard deviations.
UNLIKELY = 5000.0


def innovation_limit(size: int) -> float:
    """The squared innovation of so many outputs over its covariance above which it is an entry."""
    return size + 2.0 * math.sqrt(size * UNLIKELY) + 2.0 * UNLIKELY


class Diagnosis(NamedTuple):
    """Something that is wrong with an estimate: a key of `CURES`, the sample (0 is the first), what to try, and at how
    many samples in a row.

    Examples
    --------
    >>> import flexhinf as fh
    >>> fh.Diagnosis("innovations", 12, "a larger measurement noise", count=3).step
    12
    """

    kind: str
    step: int
    cure: str
    count: int = 1  # pyright: ignore[reportIncompatibleMethodOverride]  # a tuple counts, too


class Diagnosed(Filter, Protocol):
    """A filter that says what it found by itself."""

    @property
    def diagnosis(self) -> tuple[Diagnosis, ...]:
        """Entries since the last reset."""
        ...


def recorded(entries: tuple[Diagnosis, ...], kind: str, step: int, most: int) -> tuple[Diagnosis, ...]:
    """Entries and one more, if there are no `most` yet; at the sample after the last one of an entry, this counts one
    more instead."""
    place = next((k for k in reversed(range(len(entries))) if entries[k].kind == kind), None)
    if place is not None:
        entry = entries[place]
        after = step - (entry.step + entry.count)
        if after <= 0:
            longer = entry._replace(count=entry.count + 1) if after == 0 else entry
            return (*entries[:place], longer, *entries[place + 1 :])
    return entries if len(entries) >= most else (*entries, Diagnosis(kind, step, CURES[kind]))


def about_numbers(entries: tuple[Diagnosis, ...]) -> tuple[Diagnosis, ...]:
    """Entries that say that an answer may be wrong for its inputs: all but those of unlikely measurements."""
    return tuple(entry for entry in entries if entry.kind != "innovations")


def diagnose(
    estimator: Diagnosed,
    measurements: ArrayLike | None = None,
    inputs: ArrayLike | None = None,
    seed: int = 0,
) -> tuple[Diagnosis, ...]:
    """Whether the inputs of a filter determine its answer, from recorded samples.

    The samples are filtered from the initial belief, again with up to four units of the last place added to or taken
    from each number of one input after the other, and with what is singular to rounding made definite by as much. An
    input that moves a mean by more than 1e-3 standard deviations, or a variance by more than 1e-3 of itself, does not
    determine the answer in floats, whatever the algorithm.

    Parameters
    ----------
    estimator : UnscentedKalmanFilter or ExtendedKalmanFilter
        It is not changed.
    measurements : (N, p) array, optional
        Without, the entries that the filter has collected by itself.
    inputs : (N, m) array, optional
        Held over the period after each measurement; zero by default.
    seed : int
        Of the moved bits.

    Returns
    -------
    tuple of Diagnosis
        Empty where the inputs determine the answer; what the filter found by itself first, but for "innovations",
        which are no matter of digits; then inputs that decide, each with the
        first sample at which they do.

    Raises
    ------
    InvalidInput
        If the estimator has no Gaussian belief, or samples do not fit its plant.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> ukf = fh.UnscentedKalmanFilter(fh.paper_arm().plant(), 1e-3, 1e-6, 1e-6, np.zeros(4), 1e-4)
    >>> fh.diagnose(ukf, np.zeros((2, 1)))  # nothing is wrong
    ()
    """
    refuse_if(
        not hasattr(estimator, "diagnosis"),
        "Only a Kalman filter can be diagnosed.",
        f"expected an unscented or an extended one, got {value_text(estimator)}",
        "diagnose(ukf, y, u)",
    )
    if measurements is None:
        return estimator.diagnosis
    plant = estimator.plant
    y = _samples("measurements", measurements, len(plant.outputs))
    u = _samples(
        "inputs", np.zeros((len(y), len(plant.inputs))) if inputs is None else inputs, len(plant.inputs)
    )
    refuse_if(
        len(y) != len(u),
        "Measurements and inputs have different lengths.",
        f"expected {len(y)} inputs, got {len(u)}",
        "an input for each measurement",
    )
    means, variances, found = _replayed(estimator, y, u)
    entries, rng = list(about_numbers(found)), np.random.default_rng(seed)
    for kind, move in MOVES.items():
        for definite in (False, True):
            other, seen = copy.copy(estimator), y
            other.reset()
            seen = move(other, y, rng, definite)
            if seen is None:
                continue
            step = _first_apart(means, variances, *_replayed(other, seen, u, start=False)[:2])
            if step is not None:
                entries.append(Diagnosis(kind, step, CURES[kind]))
                break
    return tuple(entries)


def _samples(what: str, values: ArrayLike, size: int) -> np.ndarray:
    array = real_array(values)
    refuse_if(
        array.ndim != 2 or array.shape[1] != size or not len(array),
        f"The {what} do not fit the plant.",
        f"expected shape (N, {size}), got {value_text(values) if array.ndim == 0 else array.shape}",
        "one row per sample",
    )
    return array


def _replayed(
    estimator: Diagnosed, y: np.ndarray, u: np.ndarray, start: bool = True
) -> tuple[np.ndarray, np.ndarray, tuple[Diagnosis, ...]]:
    """Means and variances (N, n) after the corrections, and what the filter found."""
    if start:
        estimator = copy.copy(estimator)
        estimator.reset()
    means, variances = list[np.ndarray](), list[np.ndarray]()
    for measured, held in zip(y, u, strict=True):
        if not np.isnan(measured).all():
            estimator.correct(measured)
        belief = estimator._belief
        means.append(estimator.mean)
        rooted = estimator.form == "square_root"
        variances.append((belief.root**2).sum(axis=0) if rooted else np.diag(estimator.covariance))
        estimator.predict(held)
    return np.array(means), np.array(variances), estimator.diagnosis


def _first_apart(
    means: np.ndarray, variances: np.ndarray, others: np.ndarray, spreads: np.ndarray
) -> int | None:
    """The first sample at which means or variances are further apart than `CLOSE`; below 1e-9 of a mean is none."""
    size = np.sqrt(np.maximum(np.minimum(variances, spreads), 1e-300))
    apart = np.abs(means - others)
    far = (apart > CLOSE * size) & (apart > 1e-9 * np.abs(means))
    far |= np.abs(variances - spreads) > CLOSE * np.minimum(variances, spreads)
    steps = np.flatnonzero(far.any(axis=1))
    return int(steps[0]) if len(steps) else None


def _nudged(array: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    units = rng.integers(1, 5, array.shape) * rng.choice([-1.0, 1.0], array.shape)
    return array + units * np.spacing(array) * (array != 0.0)


def _moved_covariance(matrix: np.ndarray, rng: np.random.Generator, definite: bool) -> np.ndarray | None:
    """With other last bits, or with as much added to its diagonal where it is singular to rounding; None elsewhere."""
    if definite:
        n = len(matrix)
        singular = (root_rows(matrix) ** 2).sum(axis=1).min() == 0.0 and np.any(matrix)
        return matrix + 4.0 * n * EPS * np.diag(np.diag(matrix)) if singular else None
    moved = np.tril(_nudged(matrix, rng))
    return moved + np.tril(moved, -1).T


def _move_start(
    estimator: Diagnosed, y: np.ndarray, rng: np.random.Generator, definite: bool
) -> np.ndarray | None:
    moved = _moved_covariance(estimator._start, rng, definite)
    if moved is None:
        return None
    estimator._start = moved
    estimator.initial = estimator._belief = estimator.initial_at(estimator.mean)
    return y


def _move_noise(name: str) -> Callable[..., Any]:
    def move(
        estimator: Diagnosed, y: np.ndarray, rng: np.random.Generator, definite: bool
    ) -> np.ndarray | None:
        moved = _moved_covariance(getattr(estimator, name), rng, definite)
        if moved is None:
            return None
        setattr(estimator, name, moved)
        return y

    return move


def _move_parameters(
    estimator: Diagnosed, y: np.ndarray, rng: np.random.Generator, definite: bool
) -> np.ndarray | None:
    parameters = estimator.plant.parameters
    if definite or not parameters.size:
        return None
    estimator._parameters = parameters.named(_nudged(parameters.vector(), rng))
    return y


def _move_measurements(
    estimator: Diagnosed, y: np.ndarray, rng: np.random.Generator, definite: bool
) -> np.ndarray | None:
    return None if definite else _nudged(y, rng)


MOVES: dict[str, Callable[..., Any]] = {
    "initial covariance": _move_start,
    "process noise": _move_noise("process_noise"),
    "measurement noise": _move_noise("measurement_noise"),
    "parameters": _move_parameters,
    "measurements": _move_measurements,
}
