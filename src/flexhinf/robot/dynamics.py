"""Rigid-body dynamics of trees of joints on any element: joints and frames, mass matrix, inverse and forward dynamics.

Frames have the joint's axis as their z axis. Bodies have mass, first moment and inertia about the joint, in the aligned
frame; inverse dynamics is the recursive Newton–Euler algorithm, the mass matrix the composite-rigid-body algorithm,
factored from the leaves to the base.

Placements of real robots are full of zeros and ones. Where a factor of the vectors and matrices of three is such a
number nothing is computed, so that a traced seven-link arm has some 1400 operations instead of ten thousand, and a
truncated polynomial is never multiplied by zero. Elements are numbers, symbols, truncated polynomials, or whole NumPy
arrays of numbers (one entry per point).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from flexhinf.errors import refuse_if
from flexhinf.validation import HUGE, checked_array, checked_name, distinct, real_array, value_text

#: Three elements.
Vector = Sequence[Any]

#: Three rows of three elements.
Matrix = Sequence[Vector]

ZERO: Vector = (0.0, 0.0, 0.0)
IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

NUMBERS = (float, int)


def _times(a: Any, b: Any) -> Any:
    if isinstance(b, NUMBERS):
        a, b = b, a
    if isinstance(a, NUMBERS):
        if a == 0:
            return 0.0
        if a == 1:
            return b
        if a == -1:
            return -b
    return a * b


def _plus(a: Any, b: Any) -> Any:
    if isinstance(a, NUMBERS) and a == 0:
        return b
    return a if isinstance(b, NUMBERS) and b == 0 else a + b


def _minus(a: Any, b: Any) -> Any:
    if isinstance(b, NUMBERS) and b == 0:
        return a
    return -b if isinstance(a, NUMBERS) and a == 0 else a - b


# Vectors ------------------------------------------------------------------------------------------
def _dot(a: Vector, b: Vector) -> Any:
    return _plus(_plus(_times(a[0], b[0]), _times(a[1], b[1])), _times(a[2], b[2]))


def _cross(a: Vector, b: Vector) -> Vector:
    return (
        _minus(_times(a[1], b[2]), _times(a[2], b[1])),
        _minus(_times(a[2], b[0]), _times(a[0], b[2])),
        _minus(_times(a[0], b[1]), _times(a[1], b[0])),
    )


def _add(a: Vector, b: Vector) -> Vector:
    return tuple(map(_plus, a, b))


def _scaled(factor: Any, a: Vector) -> Vector:
    return tuple(_times(factor, x) for x in a)


# Matrices -----------------------------------------------------------------------------------------
def _apply(m: Matrix, a: Vector) -> Vector:
    return tuple(_dot(row, a) for row in m)


def _transpose(m: Matrix) -> Matrix:
    return tuple(zip(*m, strict=True))


def _product(m: Matrix, n: Matrix) -> Matrix:
    columns = _transpose(n)
    return tuple(tuple(_dot(row, column) for column in columns) for row in m)


def rotated_symmetric(r: Matrix, m: Matrix) -> Matrix:
    """r m rᵀ for a symmetric m; each entry is computed once."""
    half = _product(r, m)
    return _symmetric(lambda i, j: _dot(half[i], r[j]))


def _symmetric(entry: Callable[[int, int], Any]) -> Matrix:
    (a,), (b, c), (d, e, f) = ([entry(i, j) for j in range(i + 1)] for i in range(3))
    return ((a, b, d), (b, c, e), (d, e, f))


#: What a joint may do.
KINDS = ("revolute", "continuous", "prismatic")

#: An entry of a rotation this near to −1, 0 or 1 is that number: cos(π/2) is 6e-17 in floating point.
SNAP = 1e-15

#: What is expected of a vector.
NUMBERS_TEXT = f"three numbers of at most {HUGE:g}"


@dataclass(frozen=True)
class Placement:
    """Where a frame is in its parent's frame, of any element.

    `rotation` takes components in this frame to components in the parent's; `translation` is this frame's origin in the
    parent's frame, m.
    """

    rotation: Matrix = IDENTITY
    translation: Vector = ZERO

    @staticmethod
    def of(xyz: Sequence[float] = (0.0, 0.0, 0.0), rpy: Sequence[float] = (0.0, 0.0, 0.0)) -> Placement:
        """From a translation (m) and roll, pitch, yaw (rad) about fixed x, y, z: R = Rz(yaw) Ry(pitch) Rx(roll)."""
        for name, value in (("xyz", xyz), ("rpy", rpy)):
            checked_array(f"The {name} is no vector.", value, (3,), NUMBERS_TEXT, "[0, 0, 1]", HUGE)
        (sr, cr), (sp, cp), (sy, cy) = ((_snap(math.sin(a)), _snap(math.cos(a))) for a in map(float, rpy))
        rotation = (
            (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
            (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
            (-sp, cp * sr, cp * cr),
        )
        return Placement(_snapped(rotation), (float(xyz[0]), float(xyz[1]), float(xyz[2])))

    def then(self, other: Placement) -> Placement:
        """The place, in this one's parent, of a frame that is at `other` in this one."""
        moved = _add(self.translation, _apply(self.rotation, other.translation))
        return Placement(_snapped(_product(self.rotation, other.rotation)), tuple(map(float, moved)))


@dataclass(frozen=True)
class Joint:
    """One joint, and the frame of the link behind it: that frame moves with the link.

    Parameters
    ----------
    kind : {"revolute", "continuous", "prismatic"}
        Turns, turns without limits, or slides.
    axis : (3,)
        In the link's frame; made a unit vector.
    placement : Placement
        Of the link's frame at position zero, in the parent link's frame (the world's for the first).
    limits : (lower, upper), optional
        rad or m.
    parent : str, optional
        The joint before it; by default the one listed before (see `Tree`). "world" for the base.
    """

    name: str
    kind: str = "revolute"
    axis: Sequence[float] = (0.0, 0.0, 1.0)
    placement: Placement = Placement()
    limits: tuple[float, float] | None = None
    parent: str | None = None

    def __post_init__(self) -> None:
        checked_name("a joint", self.name, without=",=")
        refuse_if(
            self.name == "world" or self.name == "integral" or self.name.endswith("_integral"),
            f"The joint name {self.name!r} has another meaning.",
            "expected neither 'world' (the base) nor an ending 'integral' (the integral of an error)",
            "another name",
        )
        refuse_if(
            self.kind not in KINDS,
            f"The joint {self.name!r} is of an unknown kind.",
            f"expected one of {list(KINDS)}, got {self.kind!r}",
            "merge fixed joints into their links; a planar or floating base is not supported",
        )
        axis = checked_array(
            f"The axis of joint {self.name!r} is no vector.", self.axis, (3,), NUMBERS_TEXT, "[0, 0, 1]", HUGE
        )
        length = float(np.linalg.norm(axis))
        refuse_if(
            not length > 1.0 / HUGE,
            f"The axis of joint {self.name!r} has no direction.",
            f"got {list(self.axis)}",
            "[0, 0, 1]",
        )
        object.__setattr__(self, "axis", tuple(_snap(float(a) / length) for a in self.axis))
        if self.limits is not None:
            limits = real_array(self.limits)
            refuse_if(
                limits.shape != (2,) or not limits[0] < limits[1],
                f"The limits of joint {self.name!r} leave no room.",
                f"expected lower < upper, got {value_text(self.limits)}",
                "limits = [lower, upper] in rad (m for a prismatic joint)",
            )
            object.__setattr__(self, "limits", tuple(limits.tolist()))

    @property
    def slides(self) -> bool:
        """Whether it is prismatic."""
        return self.kind == "prismatic"

    @cached_property
    def alignment(self) -> Matrix:
        """Rotation whose third column is the axis: from the aligned frame to the link's."""
        a = self.axis
        k = int(np.argmax(np.abs(a)))
        if a[(k + 1) % 3] == a[(k + 2) % 3] == 0.0:  # along ± a coordinate axis: nothing but zeros and ±1
            x, y, z = np.roll(np.eye(3), -1 - k, axis=0)
            x, z = (x, z) if a[k] > 0.0 else (-x, -z)
        else:
            z = np.array(a)
            x = np.cross(np.eye(3)[int(np.argmin(np.abs(a)))], z)
            x /= np.linalg.norm(x)
            y = np.cross(z, x)
        return _snapped(np.column_stack([x, y, z]).tolist())


@dataclass(frozen=True)
class Tree:
    """Joints on a fixed base, parents before children.

    A joint without a parent hangs on the one listed before it, the first on the world.
    """

    joints: tuple[Joint, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", tuple(self.joints))
        names = self.names
        refuse_if(not names, "There are no joints.", "expected some, got none", "a joint for each link")
        distinct("The joint", names)
        for place, joint in enumerate(self.joints):
            refuse_if(
                joint.parent not in (None, "world", *names[:place]),
                f"The joint {joint.name!r} hangs on {joint.parent!r}, which is no joint before it.",
                f"expected 'world' or one of {list(names[:place])}",
                "parents before their children; leave out parent for a chain",
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints, in order."""
        return tuple(joint.name for joint in self.joints)

    def __len__(self) -> int:
        return len(self.joints)

    @cached_property
    def parents(self) -> tuple[int, ...]:
        """Number of each joint's parent, −1 for the world."""
        places = dict(zip(("world", *self.names), range(-1, len(self))))
        return tuple(
            i - 1 if joint.parent is None else places[joint.parent] for i, joint in enumerate(self.joints)
        )

    @cached_property
    def branches(self) -> tuple[tuple[str, ...], ...]:
        """Names of the joints from the world to each tip: one branch for a chain."""
        found = list[tuple[str, ...]]()
        for place in (i for i in range(len(self)) if i not in self.parents):
            branch = list[str]()
            while place >= 0:
                branch.insert(0, self.names[place])
                place = self.parents[place]
            found.append(tuple(branch))
        return tuple(found)

    @cached_property
    def aligned(self) -> tuple[Placement, ...]:
        """Place of each aligned frame at position zero, in its parent's aligned frame."""
        places = list[Placement]()
        for joint, parent in zip(self.joints, self.parents):
            place = joint.placement
            rotation, translation = _product(place.rotation, joint.alignment), place.translation
            if parent >= 0:
                back = _transpose(self.joints[parent].alignment)
                rotation, translation = _product(back, rotation), _apply(back, translation)
            places.append(Placement(_snapped(rotation), tuple(map(float, translation))))
        return tuple(places)


def _snap(value: float) -> float:
    return float(round(value)) if abs(value - round(value)) < SNAP else value


def _snapped(rotation: Matrix) -> Matrix:
    return tuple(tuple(_snap(float(entry)) for entry in row) for row in rotation)


class Body(NamedTuple):
    """Inertial parameters of one link, seen from the origin of its aligned frame.

    Mass, kg; first moment m c (3,), kg·m; inertia 3 × 3 about the frame's origin, kg·m².
    """

    mass: Any
    moment: Vector
    inertia: Matrix


def bodies_of(tree: Tree, mass: Any, centre_of_mass: Any, inertia: Any) -> list[Body]:
    """Bodies from the parameters of the links.

    Mass (n,), kg; centre of mass (n, 3) in the link's frame, m; inertia (n, 6), xx, xy, xz, yy, yz, zz about the centre
    of mass, in axes parallel to the link's frame, kg·m².
    """
    bodies = list[Body]()
    for i, joint in enumerate(tree.joints):
        xx, xy, xz, yy, yz, zz = list(inertia[i])
        x, y, z = _apply(_transpose(joint.alignment), list(centre_of_mass[i]))
        moment = _scaled(mass[i], (x, y, z))
        (a, b, c), (_, d, e), (_, _, f) = rotated_symmetric(
            _transpose(joint.alignment), ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
        )
        mxx, myy, mzz = _times(moment[0], x), _times(moment[1], y), _times(moment[2], z)
        # Steiner: I + m (cᵀc 1 − c cᵀ)
        b, c = _minus(b, _times(moment[0], y)), _minus(c, _times(moment[0], z))
        e = _minus(e, _times(moment[1], z))
        a, d, f = _plus(a, _plus(myy, mzz)), _plus(d, _plus(mxx, mzz)), _plus(f, _plus(mxx, myy))
        bodies.append(Body(mass[i], moment, ((a, b, c), (b, d, e), (c, e, f))))
    return bodies


def lumped(bodies: Sequence[tuple[float, np.ndarray, np.ndarray]]) -> tuple[float, np.ndarray, np.ndarray]:
    """Several bodies that move together as one: mass, centre, inertia of each and of the whole.

    Masses in kg, of a positive sum; centres (3,), m, in a common frame; inertias (3, 3), kg·m², about the own centre.
    """
    mass = sum(body[0] for body in bodies)
    centre: Any = sum(body[0] * np.asarray(body[1]) for body in bodies) / mass
    inertia: Any = np.zeros((3, 3))
    for m, c, about in bodies:
        r = np.asarray(c) - centre
        inertia = inertia + (about + m * (r @ r * np.eye(3) - np.outer(r, r)))
    return mass, centre, inertia


def matrix_of(six: Any) -> np.ndarray:
    """xx, xy, xz, yy, yz, zz as a symmetric matrix, of numbers or of any element."""
    xx, xy, xz, yy, yz, zz = six
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return matrix if matrix.dtype == object else matrix.astype(float)


def six_of(matrix: np.ndarray) -> list[Any]:
    """The inverse of `matrix_of`."""
    return [matrix[i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]


def _to_parent(frame: Placement, force: Vector, moment: Vector) -> tuple[Vector, Vector]:
    turned = _apply(frame.rotation, force)
    return turned, _add(_apply(frame.rotation, moment), _cross(frame.translation, turned))


def frames_of(tree: Tree, q: Any) -> list[Placement]:
    """Places of the aligned frames in their parents' at the joint positions q (n,)."""
    frames = list[Placement]()
    for i, (joint, place) in enumerate(zip(tree.joints, tree.aligned)):
        rotation, translation = place.rotation, place.translation
        if joint.slides:
            translation = _add(translation, _scaled(q[i], tuple(row[2] for row in rotation)))
        else:
            s, c = np.sin(q[i]), np.cos(q[i])
            rotation = _product(rotation, ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
        frames.append(Placement(rotation, translation))
    return frames


def joined(own: Body, other: Body) -> Body:
    """Inertial parameters of two bodies that move together, in one frame."""
    return Body(
        _plus(own.mass, other.mass),
        _add(own.moment, other.moment),
        tuple(map(_add, own.inertia, other.inertia)),
    )


def seen_by_parent(body: Body, frame: Placement) -> Body:
    """The body about the parent's origin: h + m r, and I − [h][r] − [r][h + m r]."""
    r, h = frame.translation, _apply(frame.rotation, body.moment)
    moment = _add(h, _scaled(body.mass, r))
    inertia = rotated_symmetric(frame.rotation, body.inertia)

    def entry(i: int, j: int) -> Any:
        felt = _add(_cross(h, _cross(r, IDENTITY[j])), _cross(r, _cross(moment, IDENTITY[j])))
        return _minus(inertia[i][j], _dot(IDENTITY[i], felt))

    return Body(body.mass, moment, _symmetric(entry))


def regrouped(tree: Tree, bodies: Sequence[Body]) -> list[Body]:
    """Equivalent bodies, regrouped so that some of their inertial parameters are zero [gautier1990].

    About the axis z of a revolute joint, a mass on the axis and equal moments of inertia about x and y, without one
    about z, are the same whatever its angle: a link's mass, its first moment along z and its inertia about y are
    given to its parent, by numbers that do not depend on the joints' positions. The base needs none. Equations of
    motion and the torques of joints are those of the given bodies; forces between links are not.
    """
    moved = list(bodies)
    for i in reversed(range(len(tree))):
        if tree.joints[i].slides:
            continue
        mass, (hx, hy, hz), ((xx, xy, xz), (_, yy, yz), (_, _, zz)) = moved[i]
        moved[i] = Body(0.0, (hx, hy, 0.0), ((_minus(xx, yy), xy, xz), (xy, 0.0, yz), (xz, yz, zz)))
        if tree.parents[i] >= 0:
            part = Body(mass, (0.0, 0.0, hz), ((yy, 0.0, 0.0), (0.0, yy, 0.0), ZERO))
            moved[tree.parents[i]] = joined(moved[tree.parents[i]], seen_by_parent(part, tree.aligned[i]))
    return moved


def inverse_dynamics(
    tree: Tree, bodies: Sequence[Body], q: Any, dq: Any, ddq: Any, gravity: Vector
) -> list[Any]:
    """Joint torques M(q) q̈ + C(q, q̇) q̇ + G(q) (forces of prismatic joints), [featherstone2008].

    q, dq, ddq are (n,) of any element; with numbers 0.0 for both of the latter only G(q) is computed. `gravity` (3,) is
    the acceleration of free fall in the world's frame, m/s².
    """
    # Of each frame, in its own components: ω, rad/s, its rate α, rad/s²; the acceleration of its origin less that of
    # free fall, m/s²; and U = [α] + [ω][ω], so that a point r of the link is accelerated by U r more than the origin.
    still = ZERO, ZERO, tuple(_minus(0.0, g) for g in gravity), _spread(ZERO, ZERO)
    frames, motions = frames_of(tree, q), list[Any]()
    wrenches: list[Any] = []
    for i, (joint, parent) in enumerate(zip(tree.joints, tree.parents)):
        angular, change, linear, spread = still if parent < 0 else motions[parent]
        linear = _add(linear, _apply(spread, frames[i].translation))
        back = _transpose(frames[i].rotation)
        angular, change, linear = (_apply(back, vector) for vector in (angular, change, linear))
        coriolis, along = _cross(angular, (0.0, 0.0, dq[i])), (0.0, 0.0, ddq[i])
        if joint.slides:
            linear = _add(linear, _add(_scaled(2.0, coriolis), along))
        else:
            change = _add(change, _add(coriolis, along))
            angular = (angular[0], angular[1], _plus(angular[2], dq[i]))
        spread = _spread(angular, change)
        motions.append((angular, change, linear, spread))
        mass, moment, inertia = bodies[i]
        spin = _add(_apply(inertia, change), _cross(angular, _apply(inertia, angular)))
        force = _add(_scaled(mass, linear), _apply(spread, moment))
        wrenches.append((force, _add(spin, _cross(moment, linear))))
    torques: list[Any] = [None] * len(tree)
    for i in reversed(range(len(tree))):
        force, moment = wrenches[i]
        torques[i] = force[2] if tree.joints[i].slides else moment[2]
        parent = tree.parents[i]
        if parent >= 0:
            force, moment = _to_parent(frames[i], force, moment)
            wrenches[parent] = _add(wrenches[parent][0], force), _add(wrenches[parent][1], moment)
    return torques


def _spread(angular: Vector, change: Vector) -> Matrix:
    (x, y, z), (a, b, c) = angular, change
    xx, yy, zz, xy, xz, yz = (_times(*pair) for pair in ((x, x), (y, y), (z, z), (x, y), (x, z), (y, z)))

    def both(p: Any, q: Any) -> Any:
        return _minus(_minus(0.0, p), q)

    return (
        (both(yy, zz), _minus(xy, c), _plus(xz, b)),
        (_plus(xy, c), both(xx, zz), _minus(yz, a)),
        (_minus(xz, b), _plus(yz, a), both(xx, yy)),
    )


def mass_matrix(tree: Tree, bodies: Sequence[Body], q: Any) -> np.ndarray:
    """M(q), (n, n) of any element, at joint positions q (n,), [featherstone2008]."""
    frames = frames_of(tree, q)
    n, composite = len(tree), list(bodies)
    matrix = np.zeros((n, n), dtype=object)
    for i in reversed(range(n)):
        # Force and moment for a unit acceleration of the joint.
        mass, (x, y, _), inertia = composite[i]
        force, moment = (_minus(0.0, y), x, 0.0), tuple(row[2] for row in inertia)
        if tree.joints[i].slides:
            force, moment = (0.0, 0.0, mass), (y, _minus(0.0, x), 0.0)
        matrix[i, i] = force[2] if tree.joints[i].slides else moment[2]
        j = i
        while tree.parents[j] >= 0:
            force, moment = _to_parent(frames[j], force, moment)
            j = tree.parents[j]
            matrix[i, j] = matrix[j, i] = force[2] if tree.joints[j].slides else moment[2]
        parent = tree.parents[i]
        if parent >= 0:
            composite[parent] = joined(composite[parent], seen_by_parent(composite[i], frames[i]))
    return matrix


def forward_dynamics(
    tree: Tree,
    bodies: Sequence[Body],
    q: Any,
    dq: Any,
    torque: Any,
    gravity: Vector,
    armature: Sequence[Any] | None = None,
) -> list[Any]:
    """Joint accelerations q̈ = M(q)⁻¹ (τ − C(q, q̇) q̇ − G(q)), [featherstone2008].

    With `regrouped` bodies that is less work, for up to twelve joints, than the articulated-body algorithm, and the
    chain of operations that wait for each other is half as long. `armature` (n,) is inertia that turns (mass that
    slides) with a joint alone, a rotor behind a rigid gear, M + diag(armature); 0.0 for none. Other arguments as for
    `inverse_dynamics`.
    """
    n, fewer = len(tree), regrouped(tree, bodies)
    bias = inverse_dynamics(tree, fewer, q, dq, [0.0] * n, gravity)
    matrix = mass_matrix(tree, fewer, q)
    for i in range(n if armature is not None else 0):
        matrix[i, i] = _plus(matrix[i, i], armature[i])  # type: ignore[index]
    return _solved(matrix, [_minus(torque[i], bias[i]) for i in range(n)])


def _solved(matrix: np.ndarray, right: list[Any]) -> list[Any]:
    """x of M x = b by M = Lᵀ D L: from the leaves on, joints of different branches stay apart."""
    n, rows, x = len(right), [list(row) for row in matrix], list(right)
    lower: list[list[Any]] = [[] for _ in range(n)]
    inverse: list[Any] = [None] * n
    for k in reversed(range(n)):
        inverse[k] = 1.0 / rows[k][k]
        lower[k] = [_times(rows[k][i], inverse[k]) for i in range(k)]
        for i in range(k):
            for j in range(i + 1):
                rows[i][j] = _minus(rows[i][j], _times(lower[k][i], rows[k][j]))
            x[i] = _minus(x[i], _times(lower[k][i], x[k]))
    for k in range(n):
        x[k] = _times(x[k], inverse[k])
        for i in range(k):
            x[k] = _minus(x[k], _times(lower[k][i], x[i]))
    return x
