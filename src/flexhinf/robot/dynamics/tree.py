"""The kinematic tree: joints with their places, in frames whose z axis is the joint's.

Vectors and matrices of three on any element, with zeros and ones folded.

Placements of real robots are full of zeros and ones. Where a factor is such a number nothing is computed, so
that a traced seven-link arm has some 1400 operations instead of ten thousand, and a truncated
polynomial is never multiplied by zero. Elements are numbers, symbols, truncated polynomials, or whole NumPy
arrays of numbers (one entry per point).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.validation import HUGE, checked_array, checked_name, real_array, value_text

#: Three elements.
Vector = Sequence[Any]

#: Three rows of three elements.
Matrix = Sequence[Vector]

ZERO: Vector = (0.0, 0.0, 0.0)
IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

NUMBERS = (float, int)


def times(a: Any, b: Any) -> Any:
    """a · b."""
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


def plus(a: Any, b: Any) -> Any:
    """a + b."""
    if isinstance(a, NUMBERS) and a == 0:
        return b
    if isinstance(b, NUMBERS) and b == 0:
        return a
    return a + b


def minus(a: Any, b: Any) -> Any:
    """a − b."""
    if isinstance(b, NUMBERS) and b == 0:
        return a
    if isinstance(a, NUMBERS) and a == 0:
        return -b
    return a - b


# Vectors ------------------------------------------------------------------------------------------
def dot(a: Vector, b: Vector) -> Any:
    """a · b."""
    return plus(plus(times(a[0], b[0]), times(a[1], b[1])), times(a[2], b[2]))


def cross(a: Vector, b: Vector) -> Vector:
    """a × b."""
    return (
        minus(times(a[1], b[2]), times(a[2], b[1])),
        minus(times(a[2], b[0]), times(a[0], b[2])),
        minus(times(a[0], b[1]), times(a[1], b[0])),
    )


def add(a: Vector, b: Vector) -> Vector:
    """a + b."""
    return tuple(map(plus, a, b))


def opposite(a: Vector) -> Vector:
    """−a."""
    return tuple(minus(0.0, x) for x in a)


def scaled(factor: Any, a: Vector) -> Vector:
    """factor · a."""
    return tuple(times(factor, x) for x in a)


# Matrices -----------------------------------------------------------------------------------------
def apply(m: Matrix, a: Vector) -> Vector:
    """m a."""
    return tuple(dot(row, a) for row in m)


def apply_transposed(m: Matrix, a: Vector) -> Vector:
    """mᵀ a."""
    return apply(transpose(m), a)


def transpose(m: Matrix) -> Matrix:
    """mᵀ."""
    return tuple(zip(*m, strict=True))


def product(m: Matrix, n: Matrix) -> Matrix:
    """m n."""
    columns = transpose(n)
    return tuple(tuple(dot(row, column) for column in columns) for row in m)


def add_matrices(m: Matrix, n: Matrix) -> Matrix:
    """m + n."""
    return tuple(map(add, m, n))


def rotated_symmetric(r: Matrix, m: Matrix) -> Matrix:
    """r m rᵀ for a symmetric m; each entry is computed once."""
    half = product(r, m)
    return symmetric(lambda i, j: dot(half[i], r[j]))


def symmetric(entry: Callable[[int, int], Any]) -> Matrix:
    """A symmetric matrix from its entries (i, j) with i ≥ j."""
    (a,), (b, c), (d, e, f) = ([entry(i, j) for j in range(i + 1)] for i in range(3))
    return ((a, b, d), (b, c, e), (d, e, f))


#: What a joint may do.
KINDS = ("revolute", "continuous", "prismatic")

#: An entry of a rotation this near to −1, 0 or 1 is that number: cos(π/2) is 6e-17 in floating point.
SNAP = 1e-15

Rows = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Placement:
    """Where a frame is in its parent's frame.

    Attributes
    ----------
    rotation : 3 rows of 3
        Takes components in this frame to components in the parent's.
    translation : (3,)
        This frame's origin in the parent's frame, m.
    """

    rotation: Rows = IDENTITY  # type: ignore[assignment]
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @staticmethod
    def of(xyz: Sequence[float] = (0.0, 0.0, 0.0), rpy: Sequence[float] = (0.0, 0.0, 0.0)) -> Placement:
        """From a translation (m) and roll, pitch, yaw (rad) about fixed x, y, z: R = Rz(yaw) Ry(pitch) Rx(roll).

        Raises
        ------
        InvalidInput
            If these are not three finite numbers each.
        """
        for name, value in (("xyz", xyz), ("rpy", rpy)):
            _three(name, value)
        (sr, cr), (sp, cp), (sy, cy) = ((_snap(math.sin(a)), _snap(math.cos(a))) for a in map(float, rpy))
        rotation = (
            (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
            (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
            (-sp, cp * sr, cp * cr),
        )
        return Placement(_snapped(rotation), (float(xyz[0]), float(xyz[1]), float(xyz[2])))

    def then(self, other: Placement) -> Placement:
        """The place, in this one's parent, of a frame that is at `other` in this one."""
        moved = add(self.translation, apply(self.rotation, other.translation))
        return Placement(_snapped(product(self.rotation, other.rotation)), _floats(moved))


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

    Raises
    ------
    InvalidInput
        For an unknown kind, an axis without direction, limits in the wrong order, or a name that cannot be part
        of a state's name.
    """

    name: str
    kind: str = "revolute"
    axis: Sequence[float] = (0.0, 0.0, 1.0)
    placement: Placement = Placement()
    limits: tuple[float, float] | None = None
    parent: str | None = None

    def __post_init__(self) -> None:
        checked_name("a joint", self.name, without=",=")
        if self.name == "world" or self.name == "integral" or self.name.endswith("_integral"):
            raise InvalidInput(
                f"The joint name {self.name!r} has another meaning.",
                "expected neither 'world' (the base) nor an ending 'integral' (the integral of an error)",
                "another name",
            )
        if self.kind not in KINDS:
            raise InvalidInput(
                f"The joint {self.name!r} is of an unknown kind.",
                f"expected one of {list(KINDS)}, got {self.kind!r}",
                "merge fixed joints into their links; a planar or floating base is not supported",
            )
        length = float(np.linalg.norm(_three(f"axis of joint {self.name!r}", self.axis)))
        if not length > 1.0 / HUGE:
            raise InvalidInput(
                f"The axis of joint {self.name!r} has no direction.", f"got {list(self.axis)}", "[0, 0, 1]"
            )
        unit = tuple(_snap(float(a) / length) for a in self.axis)
        object.__setattr__(self, "axis", unit)
        if self.limits is not None:
            limits = real_array(self.limits)
            if limits.shape != (2,) or not limits[0] < limits[1]:
                raise InvalidInput(
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
    def alignment(self) -> Rows:
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

    Parameters
    ----------
    joints : sequence of Joint
        A joint without a parent hangs on the one listed before it, the first on the world.

    Raises
    ------
    InvalidInput
        If a name repeats, or a parent is not an earlier joint.
    """

    joints: tuple[Joint, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", tuple(self.joints))
        names = self.names
        if not names or len(set(names)) != len(names):
            raise InvalidInput(
                "The joints are none, or repeat.", f"expected distinct names, got {list(names)}", "rename one"
            )
        for place, joint in enumerate(self.joints):
            if joint.parent not in (None, "world", *names[:place]):
                raise InvalidInput(
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
        numbers = {"world": -1} | {name: place for place, name in enumerate(self.names)}
        return tuple(
            place - 1 if joint.parent is None else numbers[joint.parent]
            for place, joint in enumerate(self.joints)
        )

    @cached_property
    def aligned(self) -> tuple[tuple[Matrix, Vector], ...]:
        """Rotation and translation of each aligned frame at position zero, in its parent's aligned frame."""
        places = []
        for joint, parent in zip(self.joints, self.parents):
            place = joint.placement
            rotation, translation = product(place.rotation, joint.alignment), place.translation
            if parent >= 0:
                back = transpose(self.joints[parent].alignment)
                rotation, translation = product(back, rotation), apply(back, translation)
            places.append((_snapped(rotation), _floats(translation)))
        return tuple(places)


def _three(name: str, value: Sequence[float]) -> np.ndarray:
    numbers = f"three numbers of at most {HUGE:g}"
    return checked_array(f"The {name} is no vector.", value, (3,), numbers, "[0, 0, 1]", HUGE)


def _snap(value: float) -> float:
    nearest = round(value)
    return float(nearest) if abs(value - nearest) < SNAP else value


def _snapped(rotation: Matrix) -> Rows:
    return tuple(tuple(_snap(float(entry)) for entry in row) for row in rotation)  # type: ignore[return-value]


def _floats(vector: Vector) -> tuple[float, float, float]:
    x, y, z = (float(entry) for entry in vector)
    return x, y, z
