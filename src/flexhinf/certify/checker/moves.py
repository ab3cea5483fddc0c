"""Check in ball arithmetic how fast poses may change, so that the loops of all pairs stay stable along a move.

The file has the law and the loop of a certificate of pairs, the matrices of a storage function
P(λ) = P_∞ + Σ f_j (F_j − R_j) with f_j = p_j/(λ + p_j), and ρ, the largest change of an inertia matrix in a period:
M/e^ρ ≤ M′ ≤ e^ρ M. With G = Σ f_j (1 − f_j) (F_j + R_j) and c = sinh(ρ/2) it is shown that F_j > 0, R_j > 0,
S = P − cG > 0 and

    S(λ) − A(λ)ᵀ (P + cG)(λ) A(λ) > 0

for all λ of the range, where ξ⁺ = A ξ is the loop of a pair without errors. docs/theorem.md has the lemma. Speeds of
joints are such with which −r M < Ṁ < r M at every pose, in boxes of joint positions (`flexhinf.certify.checker.arm`).

Nothing is imported from the search. Every number of the file is a double, and read as this rational number.
"""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product
from math import comb
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_mat, arb_series, ctx

from flexhinf.certify.checker.arm import (
    JOINTS_IN_BOXES,
    ArmClaim,
    ArmJoint,
    Cover,
    Terms,
    column,
    inertia_of,
    polynomial,
)
from flexhinf.certify.checker.pair_claim import PairClaim, finite_numbers, refused_as_damaged
from flexhinf.certify.checker.pair_flow import free_flow
from flexhinf.certify.checker.pairs import BITS, sampled
from flexhinf.certify.checker.taylor_matrix import (
    NO_ENCLOSURE,
    TERMS,
    TaylorMatrix,
    positive_definite,
    taylor_row,
)
from flexhinf.errors import refuse_if

#: Lengths of an interval in log λ: the first, the largest and the smallest.
FIRST, LONGEST, SHORTEST = 0.1, 0.5, 1e-4

#: Degree of polynomials of u.
DEGREE = TERMS[0] - 1

#: Eigenvalues below this share of the largest are left to a Schur complement.
LARGE = 0.1

#: Coefficients by Bernstein's polynomials of 1, u, u², …, −1 ≤ u ≤ 1, as quotients: a row for each polynomial.
SHARES = [
    [
        (
            sum((-1) ** (k - i) * comb(k, i) * comb(DEGREE - k, row - i) for i in range(row + 1)),
            comb(DEGREE, row),
        )
        for k in range(DEGREE + 1)
    ]
    for row in range(DEGREE + 1)
]

#: Most functions of a storage, and statements about speeds, in a file.
MOST = 100


class Turning(NamedTuple):
    """Speeds of joints, and what they do to inertia matrices."""

    speeds: np.ndarray  # (joints,), of either sign, rad/s or m/s
    rate: float  # r, 1/s: −r M < Ṁ < r M at every pose


class MovesClaim(NamedTuple):
    """The numbers of a file."""

    loop: PairClaim  # law, loop and range of λ; no errors
    change: float  # ρ, in a period
    poles: np.ndarray  # p_j (J,), 1/s²
    constant: np.ndarray  # P_∞ (n, n)
    falling: np.ndarray  # F_j (J, n, n), with which P falls as λ grows
    rising: np.ndarray  # R_j (J, n, n)
    arm: ArmClaim | None
    turnings: tuple[Turning, ...]  # shown at every pose of the arm


class CheckedMoves(NamedTuple):
    """What holds of the moves of a file."""

    rate: float  # ρ over the period, 1/s
    low: float  # smallest λ, 1/s²
    high: float  # largest λ, 1/s²
    intervals: int
    boxes: int  # of joint positions, of all speeds


def moves_claim(numbers: Mapping[str, Any], loop: PairClaim, arm: ArmClaim | None) -> MovesClaim:
    """The claim of a parsed part of a file; InvalidInput where it is damaged."""
    with refused_as_damaged("moves of a certificate"):
        change, poles = float(finite_numbers(numbers["change"], 0)), finite_numbers(numbers["poles"], 1)
        constant, turnings = finite_numbers(numbers["constant"], 1), numbers["turnings"]
        falling, rising = (finite_numbers(numbers[name], 2) for name in ("falling", "rising"))
        n = loop.exact.states
        size = n * (n + 1) // 2
        if constant.shape != (size,) or not (len(poles), size) == falling.shape == rising.shape:
            raise ValueError("a storage has other shapes")
        if not isinstance(turnings, list) or len(turnings) > MOST or len(poles) > MOST:
            raise ValueError("no list of speeds, or too many numbers")
        speeds = [
            Turning(finite_numbers(one["speeds"], 1), float(finite_numbers(one["rate"], 0)))
            for one in turnings
        ]
        if arm is not None and any(len(one.speeds) != len(arm.joints) for one in speeds):
            raise ValueError("speeds of other joints than those of the arm")
    refuse_if(
        not (0.0 < change < 1.0 and (poles > 0.0).all() and all(one.rate > 0.0 for one in speeds)),
        "The moves of a certificate have numbers outside their ranges.",
        "expected a change between 0 and 1, positive poles and rates, got others",
        "the file that flexhinf certify has written",
    )
    rows, columns = np.tril_indices(n)

    def whole(triangles: np.ndarray) -> np.ndarray:
        matrices = np.zeros((*triangles.shape[:-1], n, n))
        matrices[..., rows, columns] = matrices[..., columns, rows] = triangles
        return matrices

    return MovesClaim(loop, change, poles, whole(constant), whole(falling), whole(rising), arm, tuple(speeds))


def check_moves(claim: MovesClaim) -> CheckedMoves | str:
    """What is proved, or the name of what is not."""
    with ctx.workprec(BITS):
        try:
            return _checked(claim)
        except NO_ENCLOSURE:
            return "a storage function"


def _checked(claim: MovesClaim) -> CheckedMoves | str:
    for part in (*claim.falling, *claim.rising):
        sizes = np.diag(part)
        if not (sizes > 0.0).all():
            return "a storage function"
        scale = arb_mat(np.diag(1.0 / np.sqrt(sizes)).tolist())
        if not positive_definite(scale * arb_mat(part.tolist()) * scale):
            return "a storage function"
    low, high = map(float, claim.loop.links[[0, -1]])
    place, length, intervals = low, FIRST, 0
    while place < high:
        end = min(high, place * float(np.exp(length)))
        if _falls(claim, place, end, first=not intervals):
            place, length, intervals = end, min(LONGEST, 1.2 * length), intervals + 1
        elif (length := 0.6 * length) < SHORTEST:
            return f"the vibrations of {np.sqrt(place):.4g} rad/s"
    boxes = 0
    for turning in claim.turnings:
        found = turning_boxes(claim.arm, turning)
        if found is None:
            return "the speed of a joint"
        boxes += found
    rate = float(np.nextafter(claim.change / claim.loop.period, 0.0))
    return CheckedMoves(rate, low, high, intervals, boxes)


def _falls(claim: MovesClaim, low: float, high: float, first: bool) -> bool:
    """Whether the inequality holds for all λ of an interval; in the first one also whether S > 0. Where S were singular
    at a later λ, so would be S − Aᵀ(P + cG)A, or not positive."""
    centre, half = (arb(low) + arb(high)) / 2, (arb(high) - arb(low)) / 2
    try:
        before, after = _storages(claim, centre, half)
        middle = np.array([[float(entry.mid()) for entry in row] for row in before.constant.tolist()])
        inverse = np.linalg.inv(np.linalg.cholesky(middle).T)
        turn = TaylorMatrix.of(inverse.tolist())
        moved = _loop(claim.loop, centre, half) @ turn
        own = turn.transpose() @ before @ turn
        return (not first or _positive(own)) and _positive(own - moved.transpose() @ after @ moved)
    except NO_ENCLOSURE:
        return False


def _storages(claim: MovesClaim, centre: arb, half: arb) -> tuple[TaylorMatrix, TaylorMatrix]:
    """P − cG and P + cG."""
    c, poles = (arb(claim.change) / 2).sinh(), [arb(p) for p in claim.poles.tolist()]
    falling, rising = ([arb_mat(part.tolist()) for part in parts] for parts in (claim.falling, claim.rising))

    def factors(link: arb_series) -> list[arb_series]:
        shares = [p / (link + p) for p in poles]
        rates = [c * share * (1 - share) for share in shares]
        return [share + sign * rate for sign in (-1, 1) for share, rate in zip(shares, rates)]

    values, constant = taylor_row(factors, centre, half), claim.constant
    rows = [values.coefficient((k, 0)).entries() for k in range(DEGREE + 1)] + [values.remainder.entries()]
    count, found = len(poles), []
    for less in (0, count):
        more = count - less
        parts = [
            sum(
                (falling[j] * row[less + j] - rising[j] * row[more + j] for j in range(count)),
                arb_mat((constant if k == 0 else 0.0 * constant).tolist()),
            )
            for k, row in enumerate(rows)
        ]
        found.append(TaylorMatrix({(k, 0): part for k, part in enumerate(parts[:-1])}, parts[-1]))
    return found[0], found[1]


def _positive(matrix: TaylorMatrix) -> bool:
    """Whether a symmetric matrix is positive definite for all u: where its eigenvalues are of one size by coefficients
    of Bernstein, else the large ones so and the others by their Schur complement, which is as smooth."""
    middle = np.array([[float(entry.mid()) for entry in row] for row in matrix.constant.tolist()])
    values, vectors = np.linalg.eigh(0.5 * (middle + middle.T))
    if values[0] <= 0.0:
        return False
    small = int(np.sum(values < LARGE * values[-1]))
    turn = TaylorMatrix.of((vectors / np.sqrt(values[-1])).tolist())
    turned = turn.transpose() @ matrix @ turn
    n = len(values)
    large = turned.rows(small, n).columns(small, n)
    if not all(map(positive_definite, _bernstein(large))):
        return False
    if not small:
        return True
    beside, own = turned.rows(small, n).columns(0, small), turned.rows(0, small).columns(0, small)
    return _positive(own - beside.transpose() @ large.inverse() @ beside)


def _bernstein(matrix: TaylorMatrix) -> Iterator[arb_mat]:
    """Matrices in whose convex hull the values of all u are: coefficients by Bernstein's polynomials."""
    for row in SHARES:
        parts = (matrix.coefficient((k, 0)) * (arb(number) / whole) for k, (number, whole) in enumerate(row))
        yield sum(parts, matrix.remainder)


def _loop(claim: PairClaim, centre: arb, half: arb) -> TaylorMatrix:
    """A (n, n) of the loop of a pair without errors; λ = centre + half·u."""
    flow = free_flow(claim, centre, half)
    acting, memory = sampled(claim.exact, centre, half, flow)
    return TaylorMatrix.stacked([[flow @ acting], [memory]])


def turning_boxes(arm: ArmClaim | None, turning: Turning) -> int | None:
    """Boxes of joint positions in which −r M < Ṁ < r M for speeds of any signs; None where that is not shown."""
    if arm is None or len(arm.joints) > JOINTS_IN_BOXES:
        return None
    with ctx.workprec(BITS):
        return _boxes(arm, turning)


def _boxes(arm: ArmClaim, turning: Turning) -> int | None:
    bodies = [
        (k, (b.mass[0], column([x[0] for x in b.centre]), inertia_of(b))) for k, b in enumerate(arm.bodies)
    ]
    loads = [(x.joint, (x.mass[0], x.centre, x.inertia * x.mass[0])) for x in arm.payloads]
    inertia, boxes = polynomial(arm.joints, [*bodies, *loads]), 0
    slopes = [_slope(arm.joints, inertia, k) for k in range(len(arm.joints))]
    moving = [k for k, slope in enumerate(slopes) if slope and turning.speeds[k]]
    for signs in product((1, -1), repeat=len(moving)):
        terms = {index: matrix * arb(turning.rate) for index, matrix in inertia.items()}
        for k, sign in zip(moving, signs):
            for index, matrix in slopes[k].items():
                terms[index] = terms[index] + matrix * (sign * arb(float(turning.speeds[k])))
        found = Cover(arm.joints, terms).boxes
        if found is None:
            return None
        boxes += found
    return boxes


def _slope(joints: tuple[ArmJoint, ...], terms: Terms, k: int) -> Terms:
    """∂M/∂q_k of a polynomial M(q); nothing where it does not depend on q_k."""
    low, high = map(arb, joints[k].ends)
    # Of x, x² in the range of a slide, and of cos, sin, cos 2, sin 2: the function of the slope, and its factor.
    slide = {1: (0, 2 / (high - low)), 2: (1, 4 / (high - low))}
    turn = {1: (2, arb(-1)), 2: (1, arb(1)), 3: (4, arb(-2)), 4: (3, arb(2))}
    rules, found = slide if joints[k].slides else turn, dict[tuple[int, ...], arb_mat]()
    for index, matrix in terms.items():
        if index[k]:
            other, factor = rules[index[k]]
            found[(*index[:k], other, *index[k + 1 :])] = matrix * factor
    return found
