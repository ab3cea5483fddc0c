"""Linear filters that double precision finds hard, against the Kalman filter in 600 bits.

R^n and R^v down to 1e-20, singular P0, outliers of up to 1e13 standard deviations, periods of 100 ms, modes that no
output sees, units many decades apart. A filter is judged where its inputs determine the answer: none of `MOVES` random
moves of all their last bits, by up to four units each, moves it by more than `CLOSE`.

`kept` reads 126 such filters on which the covariance form fails; `source` in the file says whence, and whether they
have an answer is in it, by fewer moves. As a fuzzer: an
attempt is right within `CLOSE`; where rounding decides, the filter or `flexhinf.estimation.diagnosis.diagnose` says so.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import flint
import numpy as np

from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter
from flexhinf.estimation.diagnosis import about_numbers, diagnose
from flexhinf.plant import Plant
from fuzz.tally import Tally

__all__ = [
    "ATTEMPTS",
    "CLOSE",
    "Case",
    "draw",
    "error",
    "estimates",
    "exact",
    "filter_of",
    "is_determined",
    "kept",
    "rounded",
    "run",
]

ATTEMPTS = 200

CLOSE = 1e-3
"""Of standard deviations, and of variances."""

BITS = 600

MOVES = 20

INPUTS = ("a", "c", "p0", "q", "r", "y")

KEPT = Path(__file__).resolve().parents[1] / "tests" / "estimation" / "hostile_filters.npz"


@dataclass(frozen=True)
class Case:
    """ẋ = A x + b u, y = C x; u (N,) is held over a period, y (N, p) is NaN where there is no sample.

    `units`: (n,), of the states. `steps`: Samples at which `mean` and `variance` are known (all if None), (K, n) each.
    """

    name: str
    kind: str
    period: float
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    q: np.ndarray
    r: np.ndarray
    p0: np.ndarray
    y: np.ndarray
    u: np.ndarray
    units: np.ndarray
    determined: bool | None = None
    steps: np.ndarray | None = None
    mean: np.ndarray | None = None
    variance: np.ndarray | None = None


def kept() -> Iterator[Case]:
    """The kept filters; their answers are known at the samples where some filter was worst."""
    with np.load(KEPT) as archive:
        numbers, lengths, names = archive["numbers"], archive["lengths"], archive["names"]
        table, where = archive["table"], np.concatenate([[0], np.cumsum(archive["lengths"])])
    for k, (n, p, samples, known, kind, determined, period) in enumerate(table):
        n, p, samples, known = int(n), int(p), int(samples), int(known)
        shapes = [
            (n, n),
            (n,),
            (p, n),
            (n, n),
            (p, p),
            (n, n),
            (samples, p),
            (samples,),
            (n,),
            (known,),
            (known, n),
        ]
        parts = np.split(numbers[where[k] : where[k] + lengths[k]], np.cumsum([math.prod(s) for s in shapes]))
        *parts, variance = (part.reshape(s) for part, s in zip(parts, [*shapes, (known, n)], strict=True))
        inputs, (steps, mean) = parts[:9], parts[9:]
        yield Case(
            str(names[k]),
            ("ekf", "ukf")[int(kind)],
            period,
            *inputs,
            bool(determined),
            steps.astype(int),
            mean,
            variance,
        )


@cache
def _model(n: int, p: int) -> Plant:
    return Plant(
        lambda x, u, d, q: q.a @ x + q.b * u[0], lambda x, u, q: q.c @ x, tuple(f"x{i}" for i in range(n)), ("u",),
        outputs=tuple(f"y{i}" for i in range(p)),
        parameters={"a": np.zeros((n, n)), "b": np.zeros(n), "c": np.zeros((p, n))},
    )  # fmt: skip


def filter_of(case: Case, kind: str = "", **options: Any) -> Any:
    """An estimator for a case, of its own `kind` ("ukf" or "ekf") where none is stated."""
    made = {"ekf": ExtendedKalmanFilter, "ukf": UnscentedKalmanFilter}[kind or case.kind]
    n, p = len(case.b), len(case.c)
    plant = _model(n, p).with_parameters(a=case.a, b=case.b, c=case.c)
    return made(plant, case.period, case.q, case.r, np.zeros(n), case.p0, **options)


def estimates(case: Case, estimator: Any) -> tuple[np.ndarray, np.ndarray]:
    """Means and variances after each sample's correction, (N, n) each."""
    means, variances = [], []
    for y, u in zip(case.y, case.u, strict=True):
        if not np.isnan(y[0]):
            estimator.correct(y)
        means.append(estimator.mean)
        variances.append(np.diag(estimator.covariance))
        estimator.predict([u])
    return np.array(means), np.array(variances)


def error(case: Case, means: np.ndarray, variances: np.ndarray) -> float:
    """The largest error: of means in standard deviations, of variances in parts of themselves.

    Errors of a mean below 1e-9 of itself, and of a variance below 1e-34 in its units, count as none.
    """
    steps = slice(None) if case.steps is None else case.steps
    mean, variance, found, spread = case.mean, case.variance, means[steps], variances[steps]
    if not (np.isfinite(means).all() and np.isfinite(variances).all()):
        return math.inf
    tiny = 1e-300
    off = np.abs(found - mean)
    in_spreads = np.where(off < 1e-9 * np.abs(mean), 0.0, off / np.sqrt(np.maximum(variance, tiny)))
    apart = np.abs(spread - variance)
    share = np.where(apart < 1e-34 * case.units**2, 0.0, apart / np.maximum(variance, tiny))
    return float(max(in_spreads.max(), share.max()))


def run(attempts: int, seed: int) -> Tally:
    """Try; see the module's docstring."""
    tally = Tally(
        "linear filters that are hard: noise down to 1e-20, singular P0, outliers, against 600 bits"
    )
    for attempt in range(attempts):
        case = draw(np.random.default_rng([seed, attempt]))
        estimator, how = filter_of(case), f"seed {seed}, attempt {attempt}"
        try:
            with warnings.catch_warnings(action="ignore"):
                found = estimates(case, estimator)
        except Exception as reason:
            tally.raised(reason, how)
            continue
        size = error(exact(case, estimator.sub_steps, estimator.stages), *found)
        if size <= CLOSE:
            tally.answered()
        elif about_numbers(estimator.diagnosis) or diagnose(estimator, case.y, case.u[:, None]):
            tally.typed += 1
        else:
            tally.answered(f"off by {size:.3g}, and nothing is said", how)
    return tally


# In many digits -------------------------------------------------------------------------------------------
def _matrix(array: Any) -> Any:
    return flint.arb_mat([[float(number) for number in row] for row in np.atleast_2d(array)])


def _floats(matrix: Any) -> np.ndarray:
    return np.array([[float(number) for number in row] for row in matrix.tolist()])


def transition(case: Case, sub_steps: int, stages: int) -> tuple[Any, Any]:
    """F and g of x⁺ = F x + g u, as polynomials of the Runge–Kutta steps in A, in `BITS`."""
    n = len(case.b)
    one, a, b = _matrix(np.eye(n)), _matrix(case.a), _matrix(case.b[:, None])
    h = flint.arb(case.period / sub_steps)
    term, step, drive = one, one, _matrix(np.zeros((n, n)))
    for k in range(1, stages + 1):
        drive = drive + term * (h / k)
        term = term * a * (h / k)
        step = step + term
    f, g = one, _matrix(np.zeros((n, 1)))
    for _ in range(sub_steps):
        f, g = step * f, step * g + drive * b
    return f, g


def rounded(case: Case, sub_steps: int, stages: int) -> tuple[np.ndarray, np.ndarray]:
    """F (n, n) and g (n,) in floats, for filters that ask for them."""
    with flint.ctx.workprec(BITS):
        f, g = transition(case, sub_steps, stages)
        return _floats(f), _floats(g)[:, 0]


def exact(
    case: Case, sub_steps: int, stages: int, given: tuple[np.ndarray, np.ndarray] | None = None
) -> Case:
    """The case with the answers of the Kalman filter, with its own F and g, or with those that are given."""
    with flint.ctx.workprec(BITS):
        f, g = transition(case, sub_steps, stages)
        if given is not None:
            f, g = _matrix(given[0]), _matrix(given[1][:, None])
        return replace(case, **_filtered(case, f, g))


def _filtered(case: Case, f: Any, g: Any) -> dict[str, Any]:
    c, q, r, p0 = (_matrix(array) for array in (case.c, case.q, case.r, case.p0))
    n, means, variances = len(case.b), [], []
    mean, covariance = _matrix(np.zeros((n, 1))), p0
    for y, u in zip(case.y, case.u, strict=True):
        if not np.isnan(y[0]):
            seen = c * covariance
            gain = (c * seen.transpose() + r).solve(seen).transpose()
            mean = (mean + gain * (_matrix(y[:, None]) - c * mean)).mid()
            covariance = covariance - gain * seen
            covariance = ((covariance + covariance.transpose()) * flint.arb(0.5)).mid()
        means.append(_floats(mean)[:, 0])
        variances.append([float(covariance[i, i]) for i in range(n)])
        mean = (f * mean + g * flint.arb(float(u))).mid()
        covariance = (f * covariance * f.transpose() + q).mid()
    return {"mean": np.array(means), "variance": np.array(variances), "steps": None}


def is_determined(case: Case, sub_steps: int, stages: int, rng: np.random.Generator) -> bool:
    """Whether `MOVES` moves of the inputs' last bits, up to four units each, move the answer by at most `CLOSE`."""
    for _ in range(MOVES):
        other = exact(_moved(case, rng), sub_steps, stages)
        if not error(case, other.mean, other.variance) <= CLOSE:
            return False
    return True


def _moved(case: Case, rng: np.random.Generator) -> Case:
    """The case with all numbers of `INPUTS` that are not zero moved by up to four units of their last places."""
    moved = {}
    for name in INPUTS:
        array = getattr(case, name)
        moved[name] = array + rng.integers(-4, 5, array.shape) * np.spacing(array) * (array != 0.0)
        if name in ("p0", "q", "r"):
            moved[name] = np.tril(moved[name]) + np.tril(moved[name], -1).T
    return replace(case, **moved)


# Filters that are drawn -----------------------------------------------------------------------------------
SHAPES = ((1, 1), (2, 1), (3, 1), (4, 1), (4, 2), (6, 1), (6, 2))


def _decades(rng: np.random.Generator, low: float, high: float) -> float:
    return float(10.0 ** rng.uniform(low, high))


def _dynamics(rng: np.random.Generator, n: int) -> np.ndarray:
    """Chains of integrators, oscillators, stiff, unstable, unobservable or any dynamics, 1/s."""
    drawn = rng.integers(6)
    if drawn == 0:
        return np.eye(n, k=1)
    if drawn == 1:
        return np.diag(rng.choice(rng.normal(size=2), n))  # modes alike: an output sees their sum
    a = rng.normal(size=(n, n))
    if drawn == 2:
        return (a - a.T) * _decades(rng, 0.0, 1.5)
    if drawn == 3:
        return np.diag(-(10.0 ** rng.uniform(-2.0, 2.0, n))) + 0.1 * np.triu(a, 1)
    return a + (2.0 * np.eye(n) if drawn == 4 else 0.0)


def _covariance(rng: np.random.Generator, n: int, size: float) -> np.ndarray:
    """A multiple of the identity, or V Vᵀ of any rank."""
    if rng.random() < 0.6:
        return size * np.eye(n)
    root = rng.normal(size=(n, rng.integers(1, n + 1)))
    return size * (root @ root.T)


def draw(rng: np.random.Generator, samples: int = 50) -> Case:
    """A filter and samples of its plant."""
    n, p = SHAPES[rng.integers(len(SHAPES))]
    units = 10.0 ** rng.uniform(-6.0, 6.0, n) if rng.random() < 0.3 else np.ones(n)
    a, period = _dynamics(rng, n), float(rng.choice([1e-4, 1e-3, 1e-2, 1e-1]))
    c = rng.normal(size=(p, n)) if rng.random() < 0.5 else np.eye(n)[:p]
    r = np.diag(10.0 ** rng.uniform(-20.0, 0.0, p))
    q = _covariance(rng, n, 0.0 if rng.random() < 0.2 else _decades(rng, -20.0, -2.0))
    p0 = _covariance(rng, n, _decades(rng, -6.0, 8.0))
    x, u, f = rng.normal(size=n), rng.normal(size=samples), np.eye(n) + period * a
    y = np.empty((samples, p))
    for k in range(samples):
        y[k] = c @ x + np.sqrt(np.diag(r)) * rng.normal(size=p)
        x = f @ x + period * np.eye(n)[-1] * u[k]
    if rng.random() < 0.3:
        y[rng.integers(samples, size=2)] *= _decades(rng, 1.0, 6.0)
    if rng.random() < 0.3:
        y[rng.random(samples) < 0.3] = np.nan
    scaled, b = a * units[:, None] / units, np.eye(n)[-1] * units
    return Case(
        "drawn", "ukf" if rng.random() < 0.25 else "ekf", period, scaled, b, c / units, q * np.outer(units, units), r,
        p0 * np.outer(units, units), y, u, units,
    )  # fmt: skip
