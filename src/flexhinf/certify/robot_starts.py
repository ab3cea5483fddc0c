"""Steps without a jump of the input for a box of robots: where each starts, and how far all starts stay inside.

A robot's step by a starts at its own equilibrium at −a, and with the integrator at which its input is the one that held
it. For a linear law both are terms in a and in the robot's parameters. For another law the integrator is tabled over a,
where the input of the nominal robot does not jump.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from flexhinf.certify.certificate import Certificate
from flexhinf.certify.starts import (
    UNCHANGED_INPUT,
    divided,
    path_states,
    rest_path,
    term_along,
    unchanged_input,
)
from flexhinf.certify.terms import Function, Start, Term
from flexhinf.errors import FlexhinfError
from flexhinf.hinf.step_amplitude import step_roles
from flexhinf.hinf.value_function import ValueFunction

NOMINAL_INPUT = "the integrator starts where the input of the nominal robot does not jump, whatever the robot"

_POINTS = 400  # of a path at which V is looked at, to see how far it stays inside
_KNOTS = 200  # of a table
_INSIDE = 1 - 1e-3  # V on a path stays below this share of the level, so that the check is quick
_FURTHEST = 3  # how far a path is followed, over the amplitude that its beginning predicts
_ROUNDING = 1e-14  # terms below this, relative to the largest, are what rounding left of a sum that cancels


def robot_start(statement: Certificate, side: float = -1.0) -> Start | None:
    """The path of starts without a jump of the input, for each robot its own; None where it has no such form.

    Steps of an amplitude a start at −a, seen from the goal, or with `side` 1 at +a.
    """
    free = np.array([name.endswith("_integral") for name in (signal.name for signal in statement.states)])
    linear = all(sum(powers) == 1 for law in statement.law for powers, _ in law)
    if free.sum() != 1 or len(statement.law) != 1 or not linear:
        return None
    shares, free = step_roles(tuple(signal.name for signal in statement.states), None, None)
    rest = rest_path(statement, -side * shares, free)
    if rest is None:
        return None
    path, functions = rest[0], list(rest[1])
    held = _held_input(statement, path, functions)
    if held is None:
        return None
    place = int(np.flatnonzero(free)[0])
    gains = {powers.index(1): value for powers, value in statement.law[0]}
    terms = [replace(term, coefficient=term.coefficient / gains[place]) for term in held]
    for i, gain in gains.items():
        if i != place:
            terms += [replace(term, coefficient=-gain / gains[place] * term.coefficient) for term in path[i]]
    whole = tuple(_gathered(terms) if i == place else row for i, row in enumerate(path))
    return Start(UNCHANGED_INPUT, 1.0, whole, tuple(functions))


def tabled_start(
    solution: ValueFunction, statement: Certificate, step: float, side: float = -1.0
) -> Start | None:
    """The path of starts to a step, the integrator where the nominal robot's input does not jump; None without one."""
    try:
        shares, free = step_roles(solution.state_names, None, None)
    except FlexhinfError:  # no integrator: nothing is commanded
        return None
    rest = rest_path(statement, -side * shares, free)
    if rest is None:
        return None
    path, functions = rest
    middle = {p.name: p.middle for p in statement.parameters}
    amplitudes = np.linspace(0.0, step, _KNOTS + 1)
    states = path_states(path, functions, middle, amplitudes)
    for k in range(1, len(states)):
        states[k, free] = 2 * states[k - 1, free] - states[max(k - 2, 0), free] if k > 1 else 0.0
        found = unchanged_input(solution, states[k], free)
        if found is None:
            return None
        states[k] = found
    table = tuple(tuple(column.tolist()) if moves else () for column, moves in zip(states.T, free))
    return Start(NOMINAL_INPUT, float(step), path, functions, tuple(amplitudes.tolist()), table)


def _held_input(
    statement: Certificate, path: tuple[tuple[Term, ...], ...], functions: list[Function]
) -> tuple[Term, ...] | None:
    """The input that holds the robot at −a, in deviation from that at the goal: −f_i/g2_i of the driven rate."""
    driven = [i for i, row in enumerate(statement.g2) if row[0]]
    if len(driven) != 1 or len(statement.g2[driven[0]][0]) != 1:
        return None
    (divisor,) = statement.g2[driven[0]][0]
    found: list[Term] = []
    for term in statement.drift[driven[0]]:
        moved = term_along(term, dict(enumerate(path)), statement, functions)
        if moved is None:
            return None
        found += [divided(part, divisor) for part in moved]
    return _gathered(found)


def _gathered(terms: Iterable[Term]) -> tuple[Term, ...]:
    """Like terms as one: what cancels in exact numbers must not stay as a difference of intervals."""
    sums: dict[tuple[Any, ...], list[float]] = {}
    for term in terms:
        key = term.powers, tuple(sorted(term.parameters)), term.function
        sums.setdefault(key, []).append(term.coefficient)
    largest = max((abs(c) for part in sums.values() for c in part), default=0.0)
    return tuple(
        Term(math.fsum(part), *key)
        for key, part in sums.items()
        if abs(math.fsum(part)) > _ROUNDING * largest
    )


def path_start(statement: Certificate, start: Start, amplitude: float) -> np.ndarray:
    """The start (n,) of one amplitude, every parameter in the middle of its range, in doubles."""
    return _states(start, {p.name: p.middle for p in statement.parameters}, np.array([amplitude]))[0]


def _states(start: Start, parameters: dict[str, float], amplitudes: np.ndarray) -> np.ndarray:
    """States (N, n) at amplitudes, with the table."""
    x = path_states(start.path, start.functions, parameters, amplitudes)
    for column, row in zip(x.T, start.table):
        column += np.interp(amplitudes, start.amplitudes, row) if row else 0.0
    return x


def largest_values(statement: Certificate, start: Start, amplitudes: np.ndarray) -> np.ndarray:
    """The largest V over the corners of the box at starts of some amplitudes, in doubles."""
    used = {name for row in start.path for term in row for name, _ in term.parameters}
    ends = {p.name: (p.low, p.high) for p in statement.parameters if p.name in used and p.low < p.high}
    powers = np.array([powers for powers, _ in statement.value])
    coefficients = np.array([value for _, value in statement.value])
    middle = {p.name: p.middle for p in statement.parameters}
    largest = np.full(len(amplitudes), -np.inf)
    for corner in itertools.product(*ends.values()):
        x = _states(start, middle | dict(zip(ends, corner)), amplitudes)
        value = (coefficients * np.prod(x[:, None, :] ** powers, axis=2)).sum(axis=1)
        largest = np.maximum(largest, value)
    return largest


def start_inside(statement: Certificate, start: Start, step: float | None) -> tuple[Start, ...]:
    """The path as far as V stays below the level at all corners: to `step`, if that is inside."""
    if step is not None:
        inside = largest_values(statement, start, np.linspace(0.0, step, _POINTS)).max() < statement.level
        if inside or start.table:
            return (replace(start, amplitude=float(step)),) if inside else ()
    amplitude = 1e-3
    amplitude *= float(np.sqrt(statement.level / largest_values(statement, start, np.array([amplitude]))[0]))
    grid = np.linspace(0.0, _FURTHEST * amplitude, _FURTHEST * _POINTS + 1)
    beyond = np.flatnonzero(largest_values(statement, start, grid) >= _INSIDE * statement.level)
    last = float(grid[max(beyond[0] - 1, 0)]) if len(beyond) else float(grid[-1])
    return (replace(start, amplitude=last),) if last > 0.0 else ()
