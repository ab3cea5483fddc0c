"""What is to be proved: the certificate of a solution before any search, with every number as the user has it."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.certify.certificate import Certificate
from flexhinf.certify.reading import PlantTerms, plant_terms
from flexhinf.certify.terms import Polynomial, Signal
from flexhinf.hinf.margin import Penalty, checked_pair
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.plant.plant import GeneralisedPlant
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import product

__all__ = ["statement_of"]

_BITS = 20  # of the entries of T


def statement_of(
    solution: ValueFunction,
    gamma: float | None,
    penalty: Penalty | None,
    *,
    decay: float = 0.0,
    level: float = 1.0,
    reach: float = 1.0,
    about: str = "",
) -> Certificate:
    """The certificate to be proved; arguments as `HJISolution.certify`."""
    pair = checked_pair(solution, gamma, penalty)
    terms = plant_terms(solution.problem, pair.output)
    problem = solution.problem
    unit = problem.plant.unit if isinstance(problem, GeneralisedPlant) else lambda name: ""
    disturbances = (
        problem.disturbance_names
        if isinstance(problem, GeneralisedPlant)
        else tuple(f"d{j + 1}" for j in range(solution.expansion.size[1]))
    )
    transform = coordinates(solution, terms, pair.gamma, decay)
    return Certificate(
        about=about or "a state feedback",
        states=tuple(Signal(name, unit(name)) for name in solution.state_names),
        inputs=tuple(Signal(name, unit(name)) for name in solution.input_names),
        disturbances=tuple(Signal(name, unit(name)) for name in disturbances),
        drift=terms.drift,
        g1=terms.g1,
        g2=terms.g2,
        penalty=tuple(row for row in terms.penalty if row),
        r2=tuple(map(tuple, solution.expansion.r2.tolist())),
        value=tuple(
            (tuple(powers), value)
            for degree, part in sorted(solution.value_parts.items())
            for powers, value in zip(solution.exponents(degree).tolist(), part.tolist())
            if value
        ),
        law=_law(solution),
        gamma=pair.gamma,
        decay=decay,
        level=level,
        coordinates=tuple(map(tuple, transform.tolist())),
        reach=reach,
        parameters=terms.parameters,
        functions=terms.functions,
    )


def _law(solution: Any) -> tuple[Polynomial, ...]:
    """−R2⁻¹ g2ᵀ V_xᵀ in doubles, as the controller has it; with a polynomial g2 the product's coefficients, rounded."""
    n, _, m, _ = solution.expansion.size
    parts: list[dict[tuple[int, ...], float]] = [{} for _ in range(m)]
    for i, slope in solution.slope_parts.items():
        for p, fields in solution.expansion.g2_parts.items():
            columns = [product(slope, fields[:, j], n, i - 1, p) for j in range(m)]
            values = -np.linalg.solve(solution.expansion.r2, np.array(columns))
            for row, part in zip(parts, values):
                for powers, value in zip(basis.exponents(n, i - 1 + p).tolist(), part.tolist()):
                    if value:
                        row[tuple(powers)] = row.get(tuple(powers), 0.0) + value
    return tuple(tuple(row.items()) for row in parts)


def coordinates(solution: ValueFunction, terms: PlantTerms, gamma: float, decay: float) -> np.ndarray:
    """T with V_2 = ½|z|² and r_2 diagonal, both up to the 20 bits that T is rounded to."""
    plant, p = solution.expansion, solution.P
    a, c = plant.f_parts[1], np.zeros((len(terms.penalty), len(p)))
    for row, polynomial in zip(c, terms.penalty):
        for powers, value in polynomial:
            if sum(powers) == 1:
                row[powers.index(1)] = value
    b1, b2 = plant.g1_parts[0][:, :, 0], plant.g2_parts[0][:, :, 0]
    s = b1 @ b1.T / gamma**2 - b2 @ np.linalg.solve(plant.r2, b2.T)
    quadratic = p @ a + a.T @ p + c.T @ c + p @ s @ p + decay * p
    root = np.linalg.cholesky(np.linalg.inv(p))
    _, vectors = np.linalg.eigh(-root.T @ quadratic @ root)
    transform = root @ vectors
    largest = np.abs(transform).max(axis=0, keepdims=True)
    scale = np.exp2(_BITS - 2 - np.ceil(np.log2(largest)))
    return np.round(transform * scale) / scale
