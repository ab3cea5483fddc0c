"""What is to be proved: the certificate of a solution before any search, with every number as the user has it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from flexhinf.certify.certificate import Certificate
from flexhinf.certify.reading import PlantTerms, plant_terms
from flexhinf.certify.terms import Parameter, Polynomial, Signal
from flexhinf.hinf.margin import Penalty, checked_pair
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.plant.plant import GeneralisedPlant
from flexhinf.plant.problem import Problem
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import product
from flexhinf.untrusted import HUGE

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
    disturbances = (
        problem.disturbance_names
        if isinstance(problem, GeneralisedPlant)
        else tuple(f"d{j + 1}" for j in range(solution.expansion.size[1]))
    )
    transform = coordinates(solution, terms, pair.gamma, decay)
    return Certificate(
        about=about or "a state feedback",
        states=signals(problem, solution.state_names),
        inputs=signals(problem, solution.input_names),
        disturbances=signals(problem, disturbances),
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
        law=law_polynomials(solution, terms),
        gamma=min(pair.gamma, HUGE),  # of the Hamilton–Jacobi–Bellman equation no gain is claimed
        decay=decay,
        level=level,
        coordinates=tuple(map(tuple, transform.tolist())),
        reach=reach,
        parameters=with_units(problem, terms.parameters),
        functions=terms.functions,
    )


def signals(problem: Problem | None, names: Iterable[str]) -> tuple[Signal, ...]:
    """Signals of a problem with their units; a command has that of its output."""
    return tuple(
        Signal(name, _unit(problem, name) or _unit(problem, name.removesuffix("_command"))) for name in names
    )


def with_units(problem: Problem | None, parameters: Iterable[Parameter]) -> tuple[Parameter, ...]:
    """The parameters of a problem with their units."""
    return tuple(replace(p, unit=_unit(problem, p.name)) for p in parameters)


def _unit(problem: Problem | None, name: str) -> str:
    return problem.plant.unit(name) if isinstance(problem, GeneralisedPlant) else ""


def law_polynomials(solution: ValueFunction, terms: PlantTerms) -> tuple[Polynomial, ...]:
    """−R2⁻¹ g2ᵀ V_xᵀ in doubles: with a constant g2 the controller's own numbers, else the product's, rounded."""
    n, _, m, _ = solution.expansion.size
    rows: list[dict[tuple[int, ...], float]] = [{} for _ in range(m)]
    if all(not any(term.powers) for entries in terms.g2 for row in entries for term in row):
        matrix = solution.expansion.g2_parts[0]
        for i, slope in solution.slope_parts.items():
            columns = np.array([product(slope, matrix[:, j], n, i - 1, 0) for j in range(m)])
            for row, part in zip(rows, -np.linalg.solve(solution.expansion.r2, columns)):
                powers = map(tuple, basis.exponents(n, i - 1).tolist())
                row |= {key: value for key, value in zip(powers, part.tolist()) if value}
        return tuple(tuple(row.items()) for row in rows)
    numbers = {parameter.name: (parameter.low + parameter.high) / 2 for parameter in terms.parameters}
    price = solution.input_price
    for k, slope in solution.slope_parts.items():
        for powers, along in zip(basis.exponents(n, k - 1).tolist(), slope.tolist()):
            for i, value in enumerate(along):
                for j, row in enumerate(terms.g2[i] if value else ()):
                    for term in row:
                        key = tuple(a + b for a, b in zip(powers, term.powers))
                        factor = value * term.coefficient
                        for name, power in term.parameters:
                            factor *= numbers[name] ** power
                        for target, weight in zip(rows, price[:, j].tolist()):
                            target[key] = target.get(key, 0.0) - weight * factor
    return tuple(tuple((key, value) for key, value in row.items() if value) for row in rows)


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
    return few_bits(transform)


def few_bits(matrix: np.ndarray) -> np.ndarray:
    """Each column rounded to `_BITS` bits of its largest entry: any invertible T is sound, a short one is quick."""
    largest = np.abs(matrix).max(axis=0, keepdims=True)
    scale = np.exp2(_BITS - 2 - np.ceil(np.log2(largest)))
    return np.round(matrix * scale) / scale
