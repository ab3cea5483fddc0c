"""Output feedback for a certificate: gain L, and M, X, γ_e that pay for the errors of an output-injection observer.

Found in doubles with a margin, so that the strict inequalities hold in rationals; the checker decides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from flint import fmpq

from flexhinf.certify.certificate import Certificate
from flexhinf.certify.claim import Observer
from flexhinf.certify.evaluation import linear_system
from flexhinf.certify.inequality import Algebra, Rational
from flexhinf.certify.problem_to_claim import matrix_rows, nearest_double, terms_of
from flexhinf.certify.starts import starts_of
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.hinf.linear_part import solve_riccati
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.plant.plant import GeneralisedPlant

_MARGIN = 1e-2  # of M over the slopes of the law, and of the Lyapunov inequality
_OVER = 1.5  # γ_e over the smallest one
_PASSES = 20  # of hull, M and X, which follow from each other
_HALVINGS = 60


def with_observer(
    solution: ValueFunction, certificate: Certificate, bandwidth: float, *, share: float = 0.1
) -> Certificate:
    """The certificate with an observer of the plant's states, and the starts that are left inside.

    The sensors are those of the plant of `solution`; its integrals are the controller's own. Every error decays faster
    than exp(−bandwidth · t), 1/s: L is the stationary Kalman gain for A + bandwidth. `share` is ε over the level,
    between 0 and 1, both left out.

    Raises
    ------
    InvalidInput
        As `check_bandwidth`.
    NumericalFailure
        No M and X for this law and these errors.
    """
    from scipy.linalg import solve_continuous_are

    problem = check_bandwidth(solution, bandwidth)
    size = problem.plant.n
    names = solution.state_names
    sensors = np.zeros((len(problem.plant.outputs), len(names)))
    sensors[:, :size] = problem.plant.linearise(problem.operating_point[:size])[3]
    a, b1, _ = linear_system(certificate, certificate.middle, np.zeros(len(certificate.functions)))
    linear, noise, seen = a[:size, :size], b1[:size], sensors[:, :size]
    transform = np.array(certificate.coordinates)
    spread = (transform @ transform.T)[:size, :size]
    price = np.diag(np.diag(seen @ spread @ seen.T)) / bandwidth
    covariance = solve_continuous_are(
        (linear + bandwidth * np.eye(size)).T, seen.T, bandwidth * spread, price
    )
    gain = covariance @ seen.T @ np.linalg.inv(price)
    energy = share * certificate.level
    weight, storage, gain_error = _error_energy(certificate, linear - gain @ seen, noise, energy)
    measured, gains, weights, storages = map(matrix_rows, (sensors, gain, weight, storage))
    observer = Observer(measured, names[size:], gains, weights, storages, gain_error, energy)
    claimed = replace(certificate, feedback="output injection observer", observer=observer)
    if reason := claimed.why_no_observer():
        raise _not_found(reason)
    return replace(claimed, starts=starts_of(solution, claimed)).with_proved_starts()


def check_bandwidth(solution: ValueFunction, bandwidth: float) -> GeneralisedPlant:
    """Return the problem whose sensors the observer uses; refuse one without, and a bandwidth that is not positive."""
    problem = solution.problem
    if isinstance(problem, GeneralisedPlant) and 0 < bandwidth < np.inf:
        return problem
    raise InvalidInput(
        "There is no such observer.",
        f"expected the problem of a plant with sensors and a bandwidth > 0, got {type(problem).__name__}, "
        f"{bandwidth!r}",
        "a robot's problem, and 10.0, in 1/s",
    )


def _error_energy(
    certificate: Certificate, closed: np.ndarray, noise: np.ndarray, energy: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """M, X and γ_e for which the errors are paid. The hull depends on X and M on the hull, so they are iterated."""
    size = len(closed)
    algebra = Algebra(certificate)
    laws = map(algebra.in_x, certificate.law)
    slopes = [[terms_of(algebra.moved(law.derivative(j))) for j in range(size)] for law in laws]
    backwards = np.linalg.inv(np.array(certificate.coordinates))[:, :size]
    widths = np.zeros(len(backwards))
    scale = 1 / np.linalg.norm(backwards, axis=0)
    squares = np.outer(scale, scale)
    for _ in range(_PASSES):
        weight = _weight(certificate, slopes, certificate.reach + 1.05 * widths)
        scaled = closed * scale / scale[:, None], noise / scale[:, None], weight * squares * (1 + _MARGIN)
        found = _storage(*scaled)
        if found is None:
            break
        storage, gain_error = found[0] / squares, found[1]
        within = np.einsum("ij,ji->i", backwards, np.linalg.solve(storage, backwards.T))
        before, widths = widths, np.sqrt(2 * energy * within)
        if np.all(widths <= 1.04 * before):
            return weight, storage, gain_error
    raise _not_found(f"the law's slopes where the estimates are did not settle in {_PASSES} passes")


def _not_found(reason: str) -> NumericalFailure:
    return NumericalFailure(
        "No energy of the errors was found for this observer.", reason, "another bandwidth, or degree 2"
    )


def _weight(certificate: Certificate, slopes: list[list[Rational]], widest: np.ndarray) -> np.ndarray:
    """M ≻ JᵀR2 J for all J within their bounds on |z_i| ≤ `widest_i`."""
    transform, r2 = np.array(certificate.coordinates), np.array(certificate.r2)
    size = len(slopes[0])
    at_origin, radius = np.zeros((2, len(slopes), size))  # J at 0, and how far it goes from there
    for row, entries in enumerate(slopes):
        for column, terms in enumerate(entries):
            sizes = {powers: abs(nearest_double(value)) for powers, value in terms.items() if any(powers)}
            at_origin[row, column] = nearest_double(terms.get((0,) * len(widest), fmpq(0)))
            radius[row, column] = sum(size * np.prod(widest ** np.array(e)) for e, size in sizes.items())
    scale = np.sqrt(np.diag(transform @ transform.T)[:size])
    base = at_origin.T @ r2 @ at_origin
    most = float(scale @ np.abs(base) @ scale)
    reached = radius @ scale
    extra = np.zeros((size, size))
    spread = np.sqrt(np.outer(reached, reached) * np.abs(r2)).sum() ** 2
    if spread:
        extra = np.diag((np.abs(r2) @ reached) @ (radius / scale))
    ratio = np.sqrt(spread / most) if most else 1.0
    weight = (1 + ratio) * base + ((1 + 1 / ratio) * extra if spread else 0.0)
    weight = weight * (1 + _MARGIN) + _MARGIN * np.diag(most / scale**2) / size
    return (weight + weight.T) / 2


def _storage(closed: np.ndarray, noise: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, float] | None:
    """X of AᵀX + XA + M + XGGᵀX/γ_e² = 0 with γ_e a little over the smallest; without G, γ_e = 0."""
    from scipy.linalg import solve_continuous_lyapunov

    plain = solve_continuous_lyapunov(closed.T, -weight)
    plain = (plain + plain.T) / 2
    if not noise.any():
        return plain, 0.0
    low, high = 0.0, np.sqrt(np.abs(np.linalg.eigvals(plain @ noise @ noise.T)).max())
    high = high if high > 0 else 1.0
    pushed = noise @ noise.T
    while solve_riccati(closed, pushed / high**2, weight) is None:
        low, high = high, 2 * high
        if high > 1e12:
            return None
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        found = solve_riccati(closed, pushed / middle**2, weight)
        low, high = (middle, high) if found is None else (low, middle)
        if high < low * 1.01:
            break
    gain_error = _OVER * high
    found = solve_riccati(closed, pushed / gain_error**2, weight)
    return None if found is None else (found.p, float(gain_error))
