"""Estimators and controllers: random models, covariances over many decades; outliers, huge, missing and bad samples.

Covariances are numbers, or V Vᵀ of any rank. A part of the attempts measures an angle or another state through what
wraps, jumps or has a corner, against sigma points written down again in plain NumPy.

Each attempt draws a linear model, an estimator and a sequence of samples. What is accepted is judged: belief finite,
symmetric, semidefinite and fit for the next prediction; for ordinary numbers equal to filterpy's. What is refused must
leave the belief as it was, and a few ordinary samples later (or after `reset`) the estimator must work again. Half
of the attempts go through a compiled `Controller`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter as Peer

from flexhinf import scalars
from flexhinf.errors import FlexhinfError, NumericalFailure
from flexhinf.estimation import ExtendedKalmanFilter, OutputInjectionObserver, UnscentedKalmanFilter
from flexhinf.loop import Controller
from flexhinf.plant import Law, Plant
from fuzz.tally import Tally

__all__ = ["ATTEMPTS", "run"]

ATTEMPTS = 1000

SAMPLES = 25

PERIOD = 1e-2

KINDS = (ExtendedKalmanFilter, UnscentedKalmanFilter, OutputInjectionObserver)

#: Numbers of states and of measured ones; few, so that compiled code is shared between attempts.
SHAPES = ((2, 1), (3, 2), (4, 1))


class Feedback(Law):
    """u = −Σ x − (Σ x)³: a law that makes much of an outlier."""

    law_key = "feedback"

    def __init__(self, states: tuple[str, ...]) -> None:
        self.state_names, self.input_names = states, ("u",)
        self.operating_point, self.operating_input = np.zeros(len(states)), np.zeros(1)

    @property
    def law_data(self) -> np.ndarray:
        """Gains."""
        return np.ones(2)

    def evaluate_law(self, x: Any, data: Any) -> Any:
        """k(x), (1,)."""
        total = sum(x)
        return np.array([-data[0] * total - data[1] * total**3])


def model(n: int, p: int) -> Plant:
    """ẋ = A x + (0, …, 0, u), A from its parameters; the first p states are measured."""
    states = tuple(f"x{i}" for i in range(n))
    return Plant(
        lambda x, u, d, q: q.a @ x + np.array([0.0] * (n - 1) + [u[0]]),
        lambda x, u, q: x[:p],
        states,
        ("u",),
        parameters={"a": np.zeros((n, n))},
    )


MODELS = {shape: model(*shape) for shape in SHAPES}


def run(attempts: int, seed: int) -> Tally:
    """Try; see the module's docstring."""
    tally = Tally(
        "estimators and controllers: covariances over 24 decades, outliers, missing and bad samples"
    )
    for attempt in range(attempts):
        rng = np.random.default_rng([seed, attempt])
        how = f"seed {seed}, attempt {attempt}"
        try:
            with np.errstate(all="ignore"), warnings.catch_warnings(action="ignore"):
                fault = one(rng)
        except Exception as error:
            tally.raised(error, how)
        else:
            tally.answered(fault, how)
    return tally


def one(rng: np.random.Generator) -> str:
    """One attempt; what is wrong, or nothing."""
    if rng.random() < 0.1:
        return not_linear(rng)
    shape = SHAPES[rng.integers(len(SHAPES))]
    kind = KINDS[rng.integers(len(KINDS))]
    ordinary = rng.random() < 0.4
    a = np.eye(shape[0], k=1) + rng.normal(size=(shape[0],) * 2) * (1.0 if ordinary else decades(rng, 3))
    plant = MODELS[shape].with_parameters(a=a)
    most = 2 if ordinary else 12
    r_v, r_n = 1e-6 * decades(rng, most) * (rng.random() < 0.8), 1e-6 * decades(rng, most)
    p0: Any = decades(rng, most)
    if rng.random() < 0.4:
        p0 = of_rank(rng, shape[0], 0.2 * most)
    if kind is OutputInjectionObserver and not r_v:
        r_v = r_n
    estimator = kind(plant, PERIOD, r_v, r_n, np.zeros(shape[0]), p0)
    if rng.random() < 0.5:
        return controlled(rng, estimator)
    if np.ndim(p0) and kind is not OutputInjectionObserver:
        estimator.predict([0.0])  # what was accepted can be used
    if ordinary and kind is not OutputInjectionObserver:
        return against_filterpy(rng, estimator)
    return alone(rng, estimator)


def decades(rng: np.random.Generator, most: float) -> float:
    """A positive number within so many decades of one."""
    return float(10.0 ** rng.uniform(-most, most))


def of_rank(rng: np.random.Generator, n: int, most: float) -> np.ndarray:
    """V Vᵀ, V of n rows scaled over so many decades and up to n columns."""
    root = rng.normal(size=(n, rng.integers(0, n + 1))) * 10.0 ** rng.uniform(-most, most, (n, 1))
    return root @ root.T


#: Outputs of one state whose slope is constant wherever they have one.
KINKED: tuple[Callable[[Any], Any], ...] = (
    lambda x: np.arctan2(np.sin(x), np.cos(x)), lambda x: np.arctan(np.tan(x)), lambda x: np.arcsin(np.sin(x)),
    lambda x: np.arccos(np.cos(x)), np.abs, np.floor, np.ceil, scalars.sign, lambda x: x - np.floor(x),
    lambda x: scalars.clip(x, -1.0, 1.0), lambda x: scalars.maximum(x, 0.1), lambda x: scalars.minimum(x, 0.1),
    lambda x: scalars.where(x > 0.2, x, 2.0 * x), lambda x: np.sqrt(x * x),
)  # fmt: skip


def not_linear(rng: np.random.Generator) -> str:
    """One correction through such an output and a linear one."""
    kink = KINKED[rng.integers(len(KINKED))]
    plant = Plant(
        lambda x, u, d, q: np.array([x[1], u[0]]),
        lambda x, u, q: np.array([kink(x[0]), x[0] + x[1]]),
        ("a", "b"),
        ("u",),
    )
    mean, root = 3.0 * rng.normal(size=2), np.tril(rng.normal(size=(2, 2))) + 2.0 * np.eye(2)
    noise, y = 0.1 + rng.random(), rng.normal(size=2)
    ukf = UnscentedKalmanFilter(plant, PERIOD, 1e-6, noise, mean, root @ root.T)
    ukf.correct(y)
    columns = np.asarray(ukf.initial.root).T  # which root of the covariance is the filter's choice
    if not np.allclose(columns @ columns.T, root @ root.T, rtol=1e-12):
        return f"{columns} is no root of {root @ root.T}"
    offsets = np.sqrt(2.0) * columns
    points = mean[:, None] + np.hstack([np.zeros((2, 1)), offsets, -offsets])
    seen = np.array([[float(kink(x[0])), x[0] + x[1]] for x in points.T]).T
    if kink is KINKED[0]:  # an angle of arctan2 moves the shorter way round
        seen[0] = seen[0, 0] + np.angle(np.exp(1j * (seen[0] - seen[0, 0])))
    weights, central = np.array([0.0, *[0.25] * 4]), np.array([2.0, *[0.25] * 4])
    spread, apart = seen - (seen @ weights)[:, None], points - mean[:, None]
    gain = (apart * central) @ spread.T @ np.linalg.inv((spread * central) @ spread.T + noise * np.eye(2))
    expected = mean + gain @ (y - seen @ weights)
    return (
        "" if np.allclose(ukf.mean, expected, rtol=1e-9, atol=1e-9) else f"{ukf.mean} instead of {expected}"
    )


def sample(rng: np.random.Generator, p: int) -> Any:
    """A measurement: mostly ordinary, sometimes an outlier, huge, missing, not finite, or of another kind."""
    ordinary = rng.normal(size=p)
    drawn = rng.random()
    if drawn < 0.6:
        return ordinary
    if drawn < 0.7:
        return None
    if drawn < 0.85:
        return ordinary * 10.0 ** rng.uniform(0, 12)
    others: list[Any] = [
        ordinary * 1e200, np.full(p, np.nan), np.full(p, -np.inf), np.full(p, 1.7e308), ordinary[:-1], "far",
        [None] * p, np.where(rng.random(p) < 0.5, ordinary, np.nan), np.zeros((p, 2)), 10**400, 1j, np.full(p, 5e-324),
    ]  # fmt: skip
    return others[rng.integers(len(others))]


# The shell: predict and correct ---------------------------------------------------------------------
def alone(rng: np.random.Generator, estimator: Any) -> str:
    """Hostile samples; after each of them the belief is one, and at the end the estimator works."""
    p = len(estimator.plant.outputs)
    for _ in range(SAMPLES):
        for update, value in ((estimator.correct, sample(rng, p)), (estimator.predict, sample(rng, 1))):
            before, entries = (estimator.mean, estimator.covariance), set(estimator.diagnosis)
            refused = False
            try:
                if value is not None:
                    update(value)
            except NumericalFailure as error:
                return f"{type(estimator).__name__}.{update.__name__}({value!r}) raised {error}"
            except FlexhinfError:
                refused = True
            found = {entry.kind for entry in set(estimator.diagnosis) - entries}
            refused |= bool(found - {"digits", "innovations"})
            after = estimator.mean, estimator.covariance
            if refused and not all(np.array_equal(x, y) for x, y in zip(before, after)):
                return f"{type(estimator).__name__}.{update.__name__} was refused and changed the belief"
            fault = belief_fault(estimator)
            if fault:
                return f"{type(estimator).__name__}.{update.__name__}({value!r}): {fault}"
    estimator.reset()
    for _ in range(3):
        estimator.correct(0.1 * rng.normal(size=p))
        estimator.predict([0.0])
    return belief_fault(estimator)


def belief_fault(estimator: Any) -> str:
    """What is wrong with a mean and a covariance, or nothing."""
    mean, covariance = estimator.mean, estimator.covariance
    if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
        return "not finite"
    if not np.array_equal(covariance, covariance.T):
        return "not symmetric"
    size = np.sqrt(np.abs(np.diag(covariance)))
    unit = np.where(size > 0.0, size, 1.0)
    smallest = np.linalg.eigvalsh(covariance / unit / unit[:, None]).min()
    return f"smallest eigenvalue of the correlations {smallest:.3g}" if smallest < -1e-12 else ""


def against_filterpy(rng: np.random.Generator, estimator: Any) -> str:
    """Ordinary numbers: the Kalman filter of the linear model, with gaps in the measurements."""
    plant, n, p = estimator.plant, estimator.plant.n, len(estimator.plant.outputs)
    peer = Peer(dim_x=n, dim_z=p)
    peer.x, peer.P = np.zeros((n, 1)), np.array(estimator.covariance)
    peer.Q, peer.R, h = estimator.process_noise, estimator.measurement_noise, np.eye(n)[:p]
    drive, origin = np.zeros(n), np.zeros(n)
    named = plant.parameters.named(plant.parameters.vector())
    u = rng.normal(size=1)
    drive = estimator.transition(origin, u, named)
    peer.F = np.column_stack([estimator.transition(x, np.zeros(1), named) for x in np.eye(n)])
    for _ in range(SAMPLES):
        if rng.random() < 0.8:
            y = rng.normal(size=p)
            estimator.correct(y)
            peer.update(y[:, None], lambda _: h, lambda x: h @ x)
        estimator.predict(u)
        peer.predict()
        peer.x = peer.x + drive[:, None]
    size = np.sqrt(np.diag(peer.P))
    apart = np.abs(estimator.mean - peer.x[:, 0]) / (size + np.abs(peer.x[:, 0]))
    if apart.max() > 1e-6:
        return f"{type(estimator).__name__}: {apart.max():.3g} deviations from filterpy's mean"
    difference, size = np.abs(estimator.covariance - peer.P).max(), np.abs(peer.P).max()
    largest = 1.0 + np.abs(peer.x).max()
    rounding = (1e-14 * largest) ** 2  # of sigma points about a mean that is known exactly
    if difference > 1e-6 * size + rounding:
        return f"{type(estimator).__name__}: covariance {difference:.3g} from filterpy's of {size:.3g}"
    return ""


# The compiled controller ----------------------------------------------------------------------------
def controlled(rng: np.random.Generator, estimator: Any) -> str:
    """Hostile samples through `Controller.step`; then ordinary ones, or missing ones: it must come back by itself."""
    limit = None if rng.random() < 0.5 else 10.0
    controller = Controller(Feedback(estimator.plant.states), estimator, PERIOD, limit)
    p, began = len(controller.measured), False
    for _ in range(SAMPLES):
        y = sample(rng, p)
        before = controller.estimate
        try:
            u = controller.step(y)
        except FlexhinfError:
            if not np.array_equal(before, controller.estimate, equal_nan=True):
                return f"step({y!r}) was refused and changed the estimate"
            continue
        began |= (
            y is not None and np.isfinite(np.asarray(y, float)).any()
        )  # before, it waits, and estimates nothing
        if not (np.isfinite(u).all() and (np.isfinite(controller.estimate).all() or not began)):
            return f"step({y!r}) returned {u!r}"
    return comes_back(rng, controller, p)


def comes_back(rng: np.random.Generator, controller: Controller, p: int) -> str:
    """After at most three failures in a row the controller works, with measurements or without."""
    failures = 0
    for _ in range(3 * SAMPLES):
        y = None if rng.random() < 0.2 else 0.1 * rng.normal(size=p)
        try:
            controller.step(y)
        except NumericalFailure:
            failures += 1
            if failures > 3:
                return "raises for ever after hostile samples"
        else:
            failures = 0
    return ""
