"""Check in ball arithmetic that all robots of a file's tolerances obey, at every pose, what a proof of pairs asks for.

The file has an arm: joints, bodies with intervals of their mass, centre of mass and inertia, and payloads. Shown is
M/(1 + δ₂) ≤ M̂ ≤ M/(1 − δ₁) body by body, which holds at every pose; beside payloads, and that all λ lie in the range of
the pairs, in boxes of joint positions that cover the joint ranges; and a bound of gravity's slope at every pose.
docs/theorem.md has the lemmas.

Nothing is imported from the search. Every number of the file is a double, and read as this rational number.
"""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false, reportUnknownLambdaType=false, reportUnknownParameterType=false

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_mat, ctx

from flexhinf.certify.checker.gravity import ArmJoint, Weight, within_slope
from flexhinf.certify.checker.pair_claim import finite_numbers, refused_as_damaged
from flexhinf.certify.checker.pairs import BITS
from flexhinf.certify.checker.taylor_matrix import frobenius, positive_definite

#: Most joints of an arm in a file, of one whose joint ranges are covered by boxes, and boxes of one inequality.
MOST_JOINTS, JOINTS_IN_BOXES, BOXES = 40, 4, 20_000

#: Positions at which an inertia matrix is computed for its trigonometric polynomial: of a turn, and of a slide.
TURNED, SLID = 5, 3

#: How near to 1 the lengths of axes and of the rows of rotations are.
TURNS = 1e-12

#: A term whose coefficients are below this share of the largest counts as a bound alone.
SMALL = 1e-20

#: A number's value in the model, and its lower and upper end.
Interval = tuple[arb, arb, arb]


class ArmBody(NamedTuple):
    """The body of a link: the model's number, and the ends of the interval that all robots of the file have."""

    mass: Interval  # kg
    centre: tuple[Interval, ...]  # (3,), m, in the link's frame
    inertia: tuple[Interval, ...]  # (6,), xx xy xz yy yz zz about the centre, kg·m²
    scale: Interval  # of all six
    split: arb  # t of lemma 4, between 0 and 1
    moment: (
        Interval | None
    )  # kg·m about the joint's axis, of a body whose mass and centre are not its own; else None


class ArmPayload(NamedTuple):
    """A body of a known place on a link, whose mass is not known."""

    joint: int
    mass: Interval  # kg
    centre: arb_mat  # (3, 1), m, in the link's frame
    inertia: arb_mat  # (3, 3), over its mass, m²


class ArmClaim(NamedTuple):
    """The numbers of a file."""

    joints: tuple[ArmJoint, ...]
    bodies: tuple[ArmBody, ...]
    payloads: tuple[ArmPayload, ...]
    lower: float  # δ₁, of the bodies and the payloads
    upper: float  # δ₂
    bodies_lower: float  # δ₁ of the bodies alone
    bodies_upper: float
    range: tuple[float, float] | None  # λ, 1/s²; None where nothing is said of it
    gravity: arb_mat  # (3, 1), acceleration of free fall in the base's frame, m/s²
    slope: float | None  # γ: −γK ≤ ∂G/∂q ≤ γK; None where nothing is said of it


class CheckedArm(NamedTuple):
    """What holds of the robots of a file."""

    lower: float  # δ₁: inertia matrices up to M/(1 − δ₁), at every pose of the joint ranges
    upper: float  # δ₂: and down to M/(1 + δ₂)
    low: float | None  # smallest λ at every such pose, 1/s²; None where poses are sampled
    high: float | None
    boxes: int  # of joint positions, of all inequalities
    slope: float | None  # γ: |∂G/∂q| ≤ γK at every pose; None where nothing is said of it
    joints: int


def arm_claim(numbers: Mapping[str, Any]) -> ArmClaim:
    """The claim of a parsed file; InvalidInput where it is damaged."""
    with refused_as_damaged("arm of a certificate"):
        joints = tuple(_joint(part, k) for k, part in enumerate(_listed(numbers["joints"])))
        bodies = tuple(_body(part) for part in _listed(numbers["bodies"]))
        payloads = tuple(_payload(part, len(joints)) for part in _listed(numbers["payloads"]))
        sectors = [
            float(finite_numbers(numbers[name], 0))
            for name in ("lower", "upper", "bodies_lower", "bodies_upper")
        ]
        ends = None if numbers["range"] is None else tuple(finite_numbers(numbers["range"], 1).tolist())
        if any(body.moment is not None for body in bodies) and (
            len(joints) > 1 or any(j.slides for j in joints)
        ):
            raise ValueError("a moment of a body that is not the only one, and turns")
        if not 0 < len(joints) == len(bodies) <= MOST_JOINTS:
            raise ValueError("no joints, too many, or another number of bodies")
        if ends is not None and not (len(ends) == 2 and 0.0 < ends[0] < ends[1]):
            raise ValueError("the range of λ is none")
        if not all(
            0.0 <= own <= whole for own, whole in ((sectors[2], sectors[0]), (sectors[3], sectors[1]))
        ):
            raise ValueError("bodies with larger errors than the whole arm")
        if not sectors[0] < 1.0:
            raise ValueError("a sector beyond 1")
        slope = None if numbers["slope"] is None else float(finite_numbers(numbers["slope"], 0))
        if slope is not None and slope < 0.0:
            raise ValueError("a slope below 0")
        fall = _matrix(numbers["gravity"], 3, 1)
        return ArmClaim(joints, bodies, payloads, *sectors, ends, fall, slope)  # type: ignore[arg-type]


def _listed(value: object) -> list[Any]:
    if not isinstance(value, list) or len(value) > MOST_JOINTS:
        raise ValueError("a list is none, or too long")
    return value


def _matrix(value: object, rows: int, columns: int) -> arb_mat:
    array = finite_numbers(value, 2 if columns > 1 else 1).reshape(-1, columns)
    if array.shape != (rows, columns):
        raise ValueError(f"expected {rows} times {columns} numbers")
    return arb_mat(array.tolist())


def _interval(value: object, least: float = -np.inf) -> Interval:
    numbers = finite_numbers(value, 1).tolist()
    if len(numbers) != 3 or not least <= numbers[1] <= numbers[2] or not least <= numbers[0]:
        raise ValueError(f"{numbers!r} is no interval")
    nominal, low, high = map(arb, numbers)
    return nominal, low, high


def _joint(part: Mapping[str, Any], place: int) -> ArmJoint:
    parent, slides = part["parent"], part["slides"]
    if isinstance(parent, bool) or not isinstance(parent, int) or not -1 <= parent < place:
        raise ValueError(f"parent {parent!r}")
    if not isinstance(slides, bool):
        raise ValueError(f"slides {slides!r}")
    low, high = finite_numbers(part["ends"], 1).tolist()
    stiffness = float(finite_numbers(part["stiffness"], 0))
    if not (low < high and stiffness > 0.0):
        raise ValueError("a joint without room or spring")
    rotation = finite_numbers(part["rotation"], 2)
    lengths = rotation @ rotation.T - np.eye(3), np.linalg.norm(finite_numbers(part["axis"], 1)) - 1.0
    if any(np.abs(one).max() > TURNS for one in lengths):
        raise ValueError("a frame that is no rotation, or an axis that is not of length 1")
    return ArmJoint(
        parent,
        slides,
        _matrix(part["rotation"], 3, 3),
        _matrix(part["translation"], 3, 1),
        _matrix(part["axis"], 3, 1),
        (low, high),
        arb(stiffness),
    )


def _body(part: Mapping[str, Any]) -> ArmBody:
    centre, inertia = (
        tuple(map(_interval, _listed(part["centre"]))),
        tuple(map(_interval, _listed(part["inertia"]))),
    )
    split = float(finite_numbers(part["split"], 0))
    if (len(centre), len(inertia)) != (3, 6) or not 0.0 < split < 1.0:
        raise ValueError("a body with other numbers")
    moment = None if part["moment"] is None else _interval(part["moment"], 0.0)
    return ArmBody(
        _interval(part["mass"], 0.0), centre, inertia, _interval(part["scale"], 0.0), arb(split), moment
    )


def _payload(part: Mapping[str, Any], count: int) -> ArmPayload:
    joint = part["joint"]
    if isinstance(joint, bool) or not isinstance(joint, int) or not 0 <= joint < count:
        raise ValueError(f"joint {joint!r}")
    six = _matrix(part["inertia_per_mass"], 6, 1).entries()
    return ArmPayload(joint, _interval(part["mass"], 0.0), _matrix(part["centre"], 3, 1), _symmetric(six))


def check_arm(claim: ArmClaim) -> CheckedArm | str:
    """What is proved, or the name of what is not."""
    with ctx.workprec(BITS):
        try:
            return _checked(claim)
        except (ZeroDivisionError, OverflowError, np.linalg.LinAlgError):  # an enclosure does not exist
            return "an inertia matrix"


def _checked(claim: ArmClaim) -> CheckedArm | str:
    for k, body in enumerate(claim.bodies):
        if not _within(body, claim.bodies_lower, claim.bodies_upper):
            return f"body {k + 1}"
    if claim.slope is not None and not within_slope(
        claim.joints, claim.gravity, weights_of(claim), claim.slope
    ):
        return "the slope of gravity"
    boxes, ends = 0, claim.range or (None, None)
    if not claim.payloads and claim.range is None:
        return CheckedArm(claim.lower, claim.upper, *ends, boxes, claim.slope, len(claim.joints))
    if len(claim.joints) > JOINTS_IN_BOXES:
        return "an arm of so many joints"
    for name, terms in inequalities(claim):
        found = Cover(claim.joints, terms).boxes
        if found is None:
            return name
        boxes += found
    return CheckedArm(claim.lower, claim.upper, *ends, boxes, claim.slope, len(claim.joints))


def weights_of(claim: ArmClaim) -> list[Weight]:
    """All bodies and payloads at their heaviest, with the largest moment about the origin of their frame; the model,
    with which a filter predicts, is among them."""
    weights: list[Weight] = []
    for k, body in enumerate(claim.bodies):
        mass = _heaviest(body.mass)
        farthest = frobenius([_largest([abs(end).upper() for end in entry]) for entry in body.centre])
        if body.moment is None:
            weights.append(Weight(k, mass, mass * farthest))
        else:
            weights.append(Weight(k, arb(0), _heaviest(body.moment)))
    for load in claim.payloads:
        mass = _heaviest(load.mass)
        weights.append(Weight(load.joint, mass, mass * frobenius(load.centre.entries())))
    return weights


def _heaviest(one: Interval) -> arb:
    """The largest of the model and of the robots."""
    nominal, _, high = one
    return _largest([nominal, high])


def _within(body: ArmBody, lower: float, upper: float) -> bool:
    """Whether Φ/(1 + δ₂) ≤ Φ̂ ≤ Φ/(1 − δ₁) for all numbers of a body: masses at their ends, the inertia less or more
    by a diagonal matrix that holds all its errors, and the centre of mass at all corners (lemma 4)."""
    own = inertia_of(body)
    less, more = _deviations(body)
    centre = column([entry[0] for entry in body.centre])
    model, zero, t = _spatial(body.mass[0], centre, own), own * 0, body.split
    heaviest, lightest = model / (1 - arb(lower)), model / (1 + arb(upper))
    for corner in product(*(entry[1:] for entry in body.centre)):
        place = column(corner)
        if not positive_definite(heaviest - _spatial(body.mass[2], place, own + more)):
            return False
        turned = _cross_matrix(place - centre)
        spread = turned.transpose() * turned * (body.mass[1] * (1 / t - 1))
        least = _spatial(body.mass[1] * (1 - t), centre, zero) + _of_turns(own - less - spread)
        if not positive_definite(least - lightest):
            return False
    return True


def column(entries: Sequence[arb]) -> arb_mat:
    """A matrix of one column."""
    return arb_mat([[entry] for entry in entries])


def inertia_of(body: ArmBody) -> arb_mat:
    """(3, 3), about the centre of mass in the model."""
    return _symmetric([entry[0] * body.scale[0] for entry in body.inertia])


def _deviations(body: ArmBody) -> tuple[arb_mat, arb_mat]:
    """Diagonal matrices D₋ and D₊ with −D₋ ≤ Î − I ≤ D₊."""
    below, above = [], []
    for entry in body.inertia:
        nominal = entry[0] * body.scale[0]
        errors = [end * factor - nominal for end in entry[1:] for factor in body.scale[1:]]
        above.append(_largest([error.upper() for error in errors]))
        below.append(_largest([-error.lower() for error in errors]))
    beside = [_largest(pair) for pair in zip(below, above)]
    xy, xz, yz = beside[1], beside[2], beside[4]
    sums = xy + xz, xy + yz, xz + yz
    less, more = ([ends[k] + other for k, other in zip((0, 3, 5), sums)] for ends in (below, above))
    return _diagonal(less), _diagonal(more)


def _largest(numbers: Sequence[arb]) -> arb:
    """The largest of numbers without a radius, and 0."""
    best = arb(0)
    for one in numbers:
        best = one if one > best else best
    return best


def _diagonal(entries: Sequence[arb]) -> arb_mat:
    zero = arb(0)
    return arb_mat(
        [[entry if i == j else zero for j in range(len(entries))] for i, entry in enumerate(entries)]
    )


def _symmetric(six: Sequence[arb]) -> arb_mat:
    xx, xy, xz, yy, yz, zz = six
    return arb_mat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _cross_matrix(vector: arb_mat) -> arb_mat:
    """The matrix of c × ·."""
    x, y, z = vector.entries()
    zero = arb(0)
    return arb_mat([[zero, -z, y], [z, zero, -x], [-y, x, zero]])


def _of_turns(inertia: arb_mat) -> arb_mat:
    """(6, 6), what a velocity does not enter."""
    zero = [arb(0)] * 3
    return arb_mat([[arb(0)] * 6 for _ in range(3)] + [zero + row for row in inertia.tolist()])


def _spatial(mass: arb, centre: arb_mat, inertia: arb_mat) -> arb_mat:
    """Φ (6, 6) of m |v + ω × c|² + ωᵀ I ω, of (v, ω) at the frame's origin."""
    rows = zip(np.eye(3, dtype=int).tolist(), (-_cross_matrix(centre)).tolist())
    moved = arb_mat([[*map(arb, left), *right] for left, right in rows])
    return moved.transpose() * moved * mass + _of_turns(inertia)


#: Σ of an index (one number a joint) times a matrix.
Terms = dict[tuple[int, ...], arb_mat]


def inequalities(claim: ArmClaim) -> Iterator[tuple[str, Terms]]:
    """What must be positive definite at every pose, by name."""
    own = [(body.mass[0], column([x[0] for x in body.centre]), inertia_of(body)) for body in claim.bodies]
    bodies = polynomial(claim.joints, list(enumerate(own)))

    def loads(k: int) -> Terms:
        """Payloads of the model, at least, and at most: k is 0, 1, 2."""
        parts = [
            (load.joint, (load.mass[k], load.centre, load.inertia * load.mass[k])) for load in claim.payloads
        ]
        return polynomial(claim.joints, parts) if parts else {}

    model = loads(0)
    if claim.payloads:
        heavier, lighter = 1 / (1 - arb(claim.lower)), 1 / (1 + arb(claim.upper))
        alone, least = 1 / (1 - arb(claim.bodies_lower)), 1 / (1 + arb(claim.bodies_upper))
        yield (
            "the payload",
            _sum((heavier - alone, bodies), (heavier, model), (arb(-1), loads(2))),
        )
        if any(load.mass[0] > load.mass[1] for load in claim.payloads):
            yield (
                "the lightest payload",
                _sum((least - lighter, bodies), (-lighter, model), (arb(1), loads(1))),
            )
    if claim.range is not None:
        low, high = map(arb, claim.range)
        springs = {(0,) * len(claim.joints): _diagonal([joint.stiffness for joint in claim.joints])}
        whole = _sum((arb(1), bodies), (arb(1), model))
        yield "the fastest vibration", _sum((arb(1), whole), (-1 / high, springs))
        yield "the slowest vibration", _sum((1 / low, springs), (arb(-1), whole))


def _sum(*parts: tuple[arb, Terms]) -> Terms:
    whole: Terms = {}
    for factor, terms in parts:
        for index, matrix in terms.items():
            whole[index] = whole[index] + matrix * factor if index in whole else matrix * factor
    return whole


def polynomial(
    joints: Sequence[ArmJoint], bodies: Sequence[tuple[int, tuple[arb, arb_mat, arb_mat]]]
) -> Terms:
    """M(q) of bodies as Σ C_k Π b_k(q): b is 1, cos, sin, cos 2, sin 2 of a turn, and 1, x, x² of a slide, which is
    x = −1 … 1 in its range. A joint on the base has 1 alone: M does not depend on it."""
    counts = [1 if joint.parent < 0 else SLID if joint.slides else TURNED for joint in joints]
    table = {
        index: _inertia_matrix(joints, bodies, [_node(*pair) for pair in zip(joints, index)])
        for index in product(*map(range, counts))
    }
    for k, count in enumerate(counts):
        if count > 1:
            table = _along(table, k, count)
    return table


def _node(joint: ArmJoint, place: int) -> arb:
    """Where a joint is at one of its nodes: m, or half turns."""
    if joint.parent < 0:
        return arb(0)
    low, high = map(arb, joint.ends)
    return (low + high) / 2 + (high - low) / 2 * (place - 1) if joint.slides else arb(2 * place) / 5


def _along(table: Terms, k: int, count: int) -> Terms:
    """Coefficients along an axis from values at its nodes."""
    if count == SLID:
        rows = [[0, 1, 0], [-arb(0.5), 0, arb(0.5)], [arb(0.5), -1, arb(0.5)]]
    else:
        angles = [arb(2 * place) / 5 for place in range(TURNED)]
        fifth = arb(1) / 5
        rows = [[fifth] * TURNED]
        for order in (1, 2):
            rows += [
                [2 * fifth * (order * angle).cos_pi() for angle in angles],
                [2 * fifth * (order * angle).sin_pi() for angle in angles],
            ]
    return {
        index: sum(
            (
                table[(*index[:k], place, *index[k + 1 :])] * arb(rows[index[k]][place])
                for place in range(1, count)
            ),
            table[(*index[:k], 0, *index[k + 1 :])] * arb(rows[index[k]][0]),
        )
        for index in table
    }


def _inertia_matrix(
    joints: Sequence[ArmJoint],
    bodies: Sequence[tuple[int, tuple[arb, arb_mat, arb_mat]]],
    places: Sequence[arb],
) -> arb_mat:
    """Σ m J_vᵀJ_v + J_ωᵀ R I Rᵀ J_ω at positions in m, or in half turns of π."""
    frames: list[tuple[arb_mat, arb_mat, arb_mat]] = []
    for joint, place in zip(joints, places):
        turn, origin = arb_mat(np.eye(3).tolist()), arb_mat(3, 1)
        if joint.parent >= 0:
            turn, origin, _ = frames[joint.parent]
        origin, turn = origin + turn * joint.translation, turn * joint.rotation
        axis = turn * joint.axis
        if joint.slides:
            origin = origin + axis * place
        else:
            around = _cross_matrix(joint.axis)
            turn = turn * (
                arb_mat(np.eye(3).tolist()) + around * place.sin_pi() + around * around * (1 - place.cos_pi())
            )
        frames.append((turn, origin, axis))
    whole = arb_mat(len(joints), len(joints))
    for own, (mass, centre, inertia) in bodies:
        turn, origin, _ = frames[own]
        point = origin + turn * centre
        moved, turned = arb_mat(len(joints), 3).tolist(), arb_mat(len(joints), 3).tolist()
        place = own
        while place >= 0:
            _, at, axis = frames[place]
            if joints[place].slides:
                moved[place] = axis.entries()
            else:
                moved[place] = (_cross_matrix(axis) * (point - at)).entries()
                turned[place] = axis.entries()
            place = joints[place].parent
        along, about = arb_mat(moved), arb_mat(turned) * turn
        whole = whole + along * along.transpose() * mass + about * inertia * about.transpose()
    return whole


class Cover:
    """Boxes of joint positions on which a trigonometric polynomial of matrices is positive definite.

    On a box about q the polynomial is G + Σ d_k G_k + R with |d_k| ≤ h_k and |R| ≤ ½ Σ h_k h_l B_kl, entry by entry,
    where B bounds second derivatives everywhere. With |x|ᵀR|x| at most r, the corners G ± … ± h_k G_k − r decide.
    """

    def __init__(self, joints: Sequence[ArmJoint], terms: Terms) -> None:
        largest = max(float(frobenius(part.entries())) for part in terms.values())
        self._terms = {
            index: part
            for index, part in terms.items()
            if not any(index) or float(frobenius(part.entries())) > SMALL * largest
        }
        self._small = sum(
            (frobenius(part.entries()) for index, part in terms.items() if index not in self._terms), arb(0)
        )
        self._joints = joints
        self.free = [k for k in range(len(joints)) if any(index[k] for index in self._terms)]

    @property
    def boxes(self) -> int | None:
        """How many cover the joint ranges; None where they do not, or there would be too many."""
        ends = [(-1.0, 1.0) if joint.slides else joint.ends for joint in self._joints]
        left, count = [[ends[k] for k in self.free]], 0
        while left:
            box = left.pop()
            count += 1
            if count > BOXES:
                return None
            split = self.split(box)
            if split is None:
                return None
            if split >= 0:
                low, high = box[split]
                middle = 0.5 * (low + high)
                if not low < middle < high:
                    return None
                left += [[*box[:split], part, *box[split + 1 :]] for part in ((low, middle), (middle, high))]
        return count

    def split(self, box: Sequence[tuple[float, float]]) -> int | None:
        """The coordinate to split, −1 where the box is shown, None where the centre is not positive definite."""
        centres = [(arb(low) + arb(high)) / 2 for low, high in box]
        halves = [(arb(high) - arb(low)) / 2 for low, high in box]
        value, slopes = self.at(centres)
        middle = np.array([[float(entry.mid()) for entry in row] for row in value.tolist()])
        sizes, turn = np.linalg.eigh(0.5 * (middle + middle.T))
        if sizes[0] <= 0.0:
            return None
        numbers = turn / np.sqrt(sizes)
        x, wide = arb_mat(numbers.tolist()), arb_mat(np.abs(numbers).tolist())

        def seen(matrix: arb_mat) -> arb_mat:
            return x.transpose() * matrix * x

        rates = [seen(slope) * half for slope, half in zip(slopes, halves)]
        bent = [
            frobenius((wide.transpose() * _sum_of(row, halves) * wide).entries()) * half / 2
            for row, half in zip(self._bends, halves)
        ]
        lost = sum(bent, arb(0)) + self._small * frobenius(wide.entries()) ** 2
        base = seen(value) - _diagonal([lost] * len(numbers))
        corners = product((1, -1), repeat=len(box))
        if all(positive_definite(base + _sum_of(rates, [arb(sign) for sign in signs])) for signs in corners):
            return -1
        if not box:
            return None
        return int(np.argmax([float(frobenius(r.entries()) + b) for r, b in zip(rates, bent)]))

    def at(self, centres: Sequence[arb]) -> tuple[arb_mat, list[arb_mat]]:
        """The polynomial and its slopes at a place."""
        tables = [_basis(self._joints[k].slides, centre) for k, centre in zip(self.free, centres)]
        value = next(iter(self._terms.values())) * 0
        slopes = [value for _ in centres]
        for index, part in self._terms.items():
            values = [table[0][index[k]] for k, table in zip(self.free, tables)]
            value = value + part * _product(values)
            for j, (k, table) in enumerate(zip(self.free, tables)):
                if index[k]:
                    rate = table[1][index[k]] * _product([*values[:j], *values[j + 1 :]])
                    slopes[j] = slopes[j] + part * rate
        return value, slopes

    @cached_property
    def _bends(self) -> list[list[arb_mat]]:
        """B_kl, bounds of second derivatives."""
        sizes = [_sizes(self._joints[k].slides) for k in self.free]
        n = len(self._joints)
        whole = [[arb_mat(n, n) for _ in self.free] for _ in self.free]
        for index, part in self._terms.items():
            size = arb_mat([[entry.abs_upper() for entry in row] for row in part.tolist()])
            for a, b in product(range(len(self.free)), repeat=2):
                factor = arb(1)
                for j, k in enumerate(self.free):
                    factor *= sizes[j][(j == a) + (j == b)][index[k]]
                whole[a][b] = whole[a][b] + size * factor
        return whole


def _sum_of(matrices: Sequence[arb_mat], factors: Sequence[arb]) -> arb_mat | int:
    """Σ of matrices times numbers; 0 of none."""
    return sum((matrix * factor for matrix, factor in zip(matrices, factors)), 0)  # type: ignore[return-value]


def _product(numbers: Sequence[arb]) -> arb:
    whole = arb(1)
    for number in numbers:
        whole *= number
    return whole


def _basis(slides: bool, at: arb) -> tuple[list[arb], list[arb]]:
    """The functions of a joint and their rates."""
    if slides:
        return [arb(1), at, at * at], [arb(0), arb(1), 2 * at]
    cosine, sine, twice_c, twice_s = at.cos(), at.sin(), (2 * at).cos(), (2 * at).sin()
    return (
        [arb(1), cosine, sine, twice_c, twice_s],
        [arb(0), -sine, cosine, -2 * twice_s, 2 * twice_c],
    )


def _sizes(slides: bool) -> tuple[list[int], list[int], list[int]]:
    """Bounds of the functions of a joint, their rates and second rates."""
    if slides:
        return [1, 1, 1], [0, 1, 2], [0, 0, 2]
    return [1, 1, 1, 1, 1], [0, 1, 1, 2, 2], [0, 1, 1, 4, 4]
