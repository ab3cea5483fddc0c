"""How expressions of symbols depend on them: not at all, linearly, or with switches.

An entry that no symbol reaches is constant: that is proved from its graph. A difference of equal terms,
cos(x1 + x2) − cos(x2 + x1), is reached all the same; such an entry counts as constant if it is the same to rounding at
points drawn at random, provided that it has no comparison in it: then it is analytic, and an analytic function that is
not constant differs at random points with probability one. Which operations switch is said in
`flexhinf.codegen.operations`.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from flexhinf.codegen.operations import ELEMENTARY, anywhere, row_of
from flexhinf.scalars.trace import built, opcodes, walk

#: Points per radius, and the radii about the origin, at which entries are compared.
POINTS, RADII = 8, (0.3, 1.0, 3.0)

#: Differences this small relative to the terms they are made of are rounding.
ROUNDING = 1e-13


def switches(expressions: ca.SX, z: ca.SX, poles: bool = True) -> ca.SX:
    """Switching expressions (s, 1) of operations that are not smooth or have poles: where one is zero, code may switch.

    `z`: casadi.SX, (k, 1), all symbols of the expressions. `poles`: With those of quotients and tangents, beyond which
    a bounded function of them goes on elsewhere, and branch points of roots and inverse sines.
    """
    function = ca.Function("walked", [z], [ca.densify(ca.vec(expressions))])
    conditions: list[ca.SX] = []

    def operation(code: int, operands: list[ca.SX]) -> ca.SX:
        row = row_of(code)
        conditions.extend(row.switches(*operands) if row else anywhere(*operands))
        if poles and row:
            conditions.extend(zero for zero in row.poles(*operands) if not zero.is_constant())
        return built(code, operands)

    list(walk(function, lambda _, element: z[element], ca.SX, operation))
    return ca.vertcat(*conditions) if conditions else ca.SX.zeros(0, 1)


def elementary(function: ca.Function) -> bool:
    """Whether a traced function has nothing but arithmetic, sines and cosines."""
    return ELEMENTARY.issuperset(opcodes(function))


def linear(function: ca.Function) -> bool:
    """Whether the results are linear (with a constant) in the first argument, as every operation of the graph says.

    The derivative does not say it: that of an angle wrapped by arctan2(sin x, cos x) is one, that of floor(x) zero.
    """
    bad: list[int] = []

    def operation(code: int, moves: list[bool]) -> bool:
        row, moving = row_of(code), {place for place, moved in enumerate(moves) if moved}
        if moving and not (row and any(moving.issubset(places) for places in row.linear)):
            bad.append(code)
        return any(moves)

    list(walk(function, lambda k, _: k == 0, lambda _: False, operation))
    return not bad


def varying(entries: ca.SX, z: ca.SX, scale: ca.SX) -> np.ndarray:
    """Which entries (r, c) are not constant in z, as booleans.

    `entries`: casadi.SX, (r, c). `z`: casadi.SX, (k, 1). `scale`: casadi.SX, (r, c), size of the terms that each entry
    is made of: what rounding is compared with.
    """
    flat, sizes = ca.densify(ca.vec(entries)), ca.densify(ca.vec(scale))
    if not flat.numel():
        return np.zeros(entries.shape, dtype=bool)
    pattern = np.asarray(ca.DM(ca.jacobian_sparsity(flat, z), 1.0)).astype(bool)
    reached = np.logical_or.reduce(pattern, axis=1)
    places = np.flatnonzero(reached)
    values, terms = _at_points(flat[places.tolist()], sizes[places.tolist()], z)
    differs = reached.copy()
    for place, value, term in zip(places, values, terms):
        fine = np.isfinite(value) & np.isfinite(term)
        same = fine.sum() >= POINTS and np.ptp(value[fine]) <= ROUNDING * term[fine].max()
        differs[place] = not (same and not switches(flat[int(place)], z, poles=False).numel())
    return differs.reshape(entries.shape, order="F")


def nonzero(entries: ca.SX, z: ca.SX, scale: ca.SX) -> np.ndarray:
    """Which entries (r, c) are not zero everywhere, as booleans; arguments as in `varying`."""
    differs = varying(entries, z, scale)
    flat, sizes = ca.densify(ca.vec(entries)), ca.densify(ca.vec(scale))
    values, terms = _at_points(flat, sizes, z)
    large = np.array([bool(np.any(~(np.abs(v) <= ROUNDING * t))) for v, t in zip(values, terms)], dtype=bool)
    return differs | large.reshape(entries.shape, order="F")


def sizes_of_rows(matrix: ca.SX, columns: int | None = None) -> ca.SX:
    """Σⱼ |mᵢⱼ| for every entry of row i, with as many columns as the matrix or as `columns`."""
    return ca.repmat(ca.sum2(ca.fabs(ca.densify(matrix))), 1, matrix.shape[1] if columns is None else columns)


def _at_points(flat: ca.SX, sizes: ca.SX, z: ca.SX) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    points = np.hstack([radius * rng.normal(size=(z.numel(), POINTS)) for radius in RADII])
    values = ca.Function("values", [z], [flat, sizes])
    shape = flat.numel(), points.shape[1]
    found, terms = (np.asarray(v, dtype=float).reshape(shape) for v in values(points))
    return found, terms
