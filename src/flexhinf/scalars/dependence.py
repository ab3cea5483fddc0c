"""What expressions of symbols depend on: which entries are constant or linear, and where code switches.

An entry that no symbol reaches is constant: that is proved from its graph. A difference of equal terms,
cos(x1 + x2) − cos(x2 + x1), is reached all the same; such an entry counts as constant if it is the same to rounding
at points drawn at random, provided that it has no comparison in it: then it is analytic, and an analytic function
that is not constant differs at random points with probability one.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

#: Points per radius, and the radii about the origin, at which entries are compared.
POINTS, RADII = 8, (0.3, 1.0, 3.0)

#: Differences this small relative to the terms they are made of are rounding.
ROUNDING = 1e-13

#: Operations that are not smooth, or jump: of the difference of their operands, of the first one, or of both.
COMPARISONS = {ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_FMIN, ca.OP_FMAX}
STEPS = {ca.OP_FABS, ca.OP_SIGN, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_IF_ELSE_ZERO, ca.OP_NOT, ca.OP_ATAN2}
PAIRS = {ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_COPYSIGN, ca.OP_AND, ca.OP_OR}

#: Operations with poles, by the place of the operand that decides where: arctan(sin x / cos x) jumps at those.
POLES = {ca.OP_TAN: 0, ca.OP_INV: 0, ca.OP_DIV: 1}

#: Operations with a branch point, and what is zero there: √(x²) is |x|, and arcsin(sin x) a triangle wave.
BRANCHES = {
    ca.OP_SQRT: lambda x: x, ca.OP_ASIN: lambda x: 1.0 - x**2, ca.OP_ACOS: lambda x: 1.0 - x**2,
}  # fmt: skip

#: Operations whose result is a linear combination of their operands.
LINEAR = {ca.OP_ASSIGN, ca.OP_ADD, ca.OP_SUB, ca.OP_NEG, ca.OP_TWICE}

#: What moves numbers, arithmetic, sines and cosines.
ELEMENTARY = {
    ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_ASSIGN, ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_NEG,
    ca.OP_TWICE, ca.OP_SQ, ca.OP_INV, ca.OP_SIN, ca.OP_COS,
}  # fmt: skip


def switches(expressions: ca.SX, z: ca.SX, poles: bool = True) -> ca.SX:
    """What decides, in operations that are not smooth or have poles, (s, 1): where one is zero, code may switch.

    `z`: casadi.SX, (k, 1), all symbols of the expressions. `poles`: With those of quotients and tangents, beyond which
    a bounded function of them goes on elsewhere, and branch points of roots and inverse sines.
    """
    function = ca.Function("walked", [z], [ca.densify(ca.vec(expressions))])
    work: dict[int, ca.SX] = {}
    found: list[ca.SX] = []
    for k in range(function.n_instructions()):
        operation, read = function.instruction_id(k), function.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            continue
        if operation == ca.OP_INPUT:
            value = z[read[1]]
        elif operation == ca.OP_CONST:
            value = ca.SX(function.instruction_constant(k))
        else:
            operands = [work[place] for place in read]
            if operation in COMPARISONS:
                found.append(operands[0] - operands[1])
            elif operation in STEPS or operation in PAIRS:
                found.extend(operands[: 2 if operation in PAIRS else 1])
            elif poles and operation in POLES and not operands[POLES[operation]].is_constant():
                found.append(operands[POLES[operation]])
            elif poles and operation in BRANCHES:
                found.append(BRANCHES[operation](operands[0]))
            value = (ca.SX.unary if len(operands) == 1 else ca.SX.binary)(operation, *operands)
        work[function.instruction_output(k)[0]] = value
    return ca.vertcat(*found) if found else ca.SX.zeros(0, 1)


def elementary(function: ca.Function) -> bool:
    """Whether a traced function has nothing but arithmetic, sines and cosines."""
    return all(function.instruction_id(k) in ELEMENTARY for k in range(function.n_instructions()))


def linear(function: ca.Function) -> bool:
    """Whether the results are linear (with a constant) in the first argument, as every operation of the graph says.

    The derivative does not say it: that of an angle wrapped by arctan2(sin x, cos x) is one, that of floor(x) zero.
    """
    moves: dict[int, bool] = {}  # of the work vector: whether a number depends on the first argument
    for k in range(function.n_instructions()):
        operation, read = function.instruction_id(k), function.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            continue
        if operation == ca.OP_INPUT:
            found = read[0] == 0
        else:
            operands = [moves[place] for place in read]
            found = any(operands)
            fixed = operation in LINEAR
            fixed |= operation == ca.OP_MUL and not all(operands)
            fixed |= operation == ca.OP_DIV and not operands[1]
            if found and not fixed:
                return False
        moves[function.instruction_output(k)[0]] = found
    return True


def varying(entries: ca.SX, z: ca.SX, scale: ca.SX) -> np.ndarray:
    """Which entries (r, c) are not constant in z, as booleans.

    `entries`: casadi.SX, (r, c). `z`: casadi.SX, (k, 1). `scale`: casadi.SX, (r, c), size of the terms that each entry
    is made of: what rounding is compared with.
    """
    flat, sizes = ca.densify(ca.vec(entries)), ca.densify(ca.vec(scale))
    if not flat.numel():
        return np.zeros(entries.shape, dtype=bool)
    reached: Any = np.asarray(ca.DM(ca.jacobian_sparsity(flat, z), 1.0)).astype(bool).any(axis=1)
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
    """Σⱼ |mᵢⱼ| for every entry of row i, with as many columns as the matrix or as asked for."""
    sizes = ca.sum2(ca.fabs(ca.densify(matrix)))
    return ca.repmat(sizes, 1, matrix.shape[1] if columns is None else columns)


def _at_points(flat: ca.SX, sizes: ca.SX, z: ca.SX) -> tuple[np.ndarray, np.ndarray]:
    """Values and sizes of terms, both (k, N), at the points."""
    rng = np.random.default_rng(1)
    points = np.hstack([radius * rng.normal(size=(z.numel(), POINTS)) for radius in RADII])
    values = ca.Function("values", [z], [flat, sizes])
    return tuple(np.asarray(v, dtype=float).reshape(flat.numel(), points.shape[1]) for v in values(points))  # type: ignore[return-value]
