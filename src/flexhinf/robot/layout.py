"""Where joints and motors stand in a robot's state, and which motors move which joints.

A motor of its own moves each joint, unless they are coupled: in differential wrists, behind the belts of a SCARA, in
parallelograms and in drives by cables the output of the gear of motor i turns by

    φ_i = Σ_j T_ij q_j,        so that        δ = θ − T q,        τ_q = Tᵀ τ_J,

with constant T, which has an inverse [lens2010]. The spring of a motor is between its gear, or its belt, and what
couples: its twist δ and its torque τ_J are those of the motor, and the links feel Tᵀ τ_J, as the coupling loses no
power. All numbers of a motor and its spring are those at the output of its own gear.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.errors import refuse_if
from flexhinf.validation import one_of

#: Rows (n,) of numbers (n,) each: T.
Rows = tuple[tuple[float, ...], ...]

#: Largest condition number of a coupling: beyond it the motors hardly move some direction of the joints.
WORST = 1e6


@dataclass(frozen=True)
class Layout:
    """Places of the joints in x = (q1 (n), q̇1 (n), q2 (e), q̇2 (e) (, i (n))): e of the n joints are elastic.

    The rotor of a joint in `rigid` turns with the link: q2 = q1. `coupling` is T, without rows where each motor moves
    its own joint.
    """

    n: int
    rigid: tuple[int, ...] = ()
    coupling: Rows = ()

    @staticmethod
    def of(states: Sequence[str]) -> Layout:
        """The layout of the named states, which say nothing of a coupling: a joint without a motor's position is
        rigid."""
        joints = [
            name.removeprefix("link_position")
            for name in states
            if name.startswith("link_position") and not name.endswith("_integral")
        ]
        return Layout(
            len(joints), tuple(i for i, joint in enumerate(joints) if f"motor_position{joint}" not in states)
        )

    @staticmethod
    def named(joints: Sequence[str], rigid: Sequence[str], coupling: Sequence[Sequence[float]]) -> Layout:
        """The layout of a robot's joints, of which some are rigid, by their names."""
        return Layout(len(joints), tuple(sorted(map(joints.index, rigid))), tuple(map(tuple, coupling)))

    @staticmethod
    def of_plant(plant: Any) -> Layout:
        """The layout of a robot's plant."""
        return replace(Layout.of(plant.states), coupling=tuple(tuple(row) for row in plant.coupling))

    @property
    def elastic(self) -> list[int]:
        """The joints with a spring."""
        return [i for i in range(self.n) if i not in self.rigid]

    @property
    def mechanical(self) -> int:
        """Number of states without the coils' currents."""
        return 4 * self.n - 2 * len(self.rigid)

    @cached_property
    def matrix(self) -> np.ndarray:
        """T (n, n)."""
        return np.array(self.coupling) if self.coupling else np.eye(self.n)

    @cached_property
    def inverse(self) -> np.ndarray:
        """T⁻¹ (n, n), with zeros where rounding leaves less than that."""
        found = np.linalg.inv(self.matrix)
        return np.where(np.abs(found) > 1e-14 * np.abs(found).max(), found, 0.0)

    def split(self, x: Any) -> tuple[Any, Any, Any, Any]:
        """q1 (n,), q̇1 (n,), q2 (e,), q̇2 (e,)."""
        n, e = self.n, self.n - len(self.rigid)
        return x[:n], x[n : 2 * n], x[2 * n : 2 * n + e], x[2 * n + e : 2 * n + 2 * e]

    # Coupling -------------------------------------------------------------------------------------
    def at_motors(self, links: Elements) -> Elements:
        """T q (n,) of any element, or (n, N): where the outputs of the gears are, by link positions; rates likewise."""
        return _product(self.matrix, links) if self.coupling else links

    def on_links(self, torques: Elements) -> Elements:
        """Tᵀ τ (n,) of any element, or (n, N): torques at the links, by those of the motors."""
        return _product(self.matrix.T, torques) if self.coupling else torques

    def on_motors(self, torques: Elements) -> Elements:
        """T⁻ᵀ τ (n,) of any element, or (n, N): torques that the motors feel, by those at the links."""
        return _product(self.inverse.T, torques) if self.coupling else torques

    def at_links(self, motors: Elements) -> Elements:
        """T⁻¹ θ (n,) of any element, or (n, N): where the links are whose springs are relaxed."""
        return _product(self.inverse, motors) if self.coupling else motors

    # Springs --------------------------------------------------------------------------------------
    def of_springs(self, motors: Elements) -> Elements:
        """The entries of the motors with a spring (e,), of one for each motor (n,)."""
        return motors[self.elastic] if self.rigid else motors

    def at_springs(self, links: Elements) -> Elements:
        """The ends of the springs (e,) on the side of the links, by link positions (n,); rates likewise."""
        return self.of_springs(self.at_motors(links))

    def engaged(self, x: Any, p: Any) -> np.ndarray:
        """A state with every spring beyond its backlash: the `Model.engaged` of a robot.

        The motors are turned on by the whole width: out of the dead zone from anywhere inside.
        """
        moved = np.array(x, dtype=float)
        self.split(moved)[2][:] += np.asarray(p.backlash, dtype=float)  # a view of the copy
        return moved

    def motors(self, links: Elements, motors: Elements) -> Elements:
        """One entry per motor (n,): its own of an elastic joint, the link's of a rigid one."""
        if not self.rigid:
            return motors
        own = iter(motors)
        return np.array([links[i] if i in self.rigid else next(own) for i in range(self.n)])

    def whole(self, x: Any) -> np.ndarray:
        """q1, q̇1, q2, q̇2 (4 n,) with the motors of rigid joints where their links are; or (4 n, N) of columns."""
        q, dq, theta, dtheta = self.split(x)
        return np.concatenate([q, dq, self.motors(q, theta), self.motors(dq, dtheta)])

    def relaxed(self, x: Any) -> np.ndarray:
        """Where the links would be (n,) if no spring were twisted, T⁻¹ θ; or (n, N) of columns."""
        q, _, theta, _ = self.split(x)
        return np.asarray(self.at_links(self.motors(q, theta)))


def _product(matrix: np.ndarray, values: Any) -> np.ndarray:
    """matrix @ values, of any element, without its zeros and ones."""
    rows = list[object]()
    for row in matrix.tolist():
        parts = [value if factor == 1.0 else factor * value for factor, value in zip(row, values) if factor]
        rows.append(sum(parts[1:], parts[0]))
    return np.array(rows)


def coupling_rows(stated: Mapping[str, Mapping[str, float]], joints: Sequence[str]) -> Rows:
    """T (n, n) by what each motor states of it, by names of joints; a motor that states nothing moves its own joint.

    Raises InvalidInput: for an unknown joint.
    """
    rows = np.eye(len(joints)).tolist()
    for motor, row in stated.items():
        for joint in row:
            one_of(f"The coupling of the motor of {motor!r} names no joint.", joint, joints)
        rows[joints.index(motor)] = [float(row.get(joint, 0.0)) for joint in joints]
    return tuple(map(tuple, rows))


def checked_coupling(name: str, rows: Any, joints: Sequence[str], rigid: Sequence[str]) -> Rows:
    """T (n, n) of the robot `name`; without rows where nothing is coupled.

    Raises InvalidInput: for another size, a T without an inverse, or a rigid joint that shares a motor.
    """
    own, size = np.eye(len(joints)), len(joints)
    matrix = np.array(rows, dtype=float) if len(rows) else own
    condition = np.inf
    if matrix.shape == own.shape and np.isfinite(matrix).all():
        condition = float(np.linalg.cond(matrix))
    refuse_if(
        not condition < WORST,
        f"The coupling of the robot {name!r} has no inverse: its motors do not move every joint.",
        f"expected θ = T q with {size} rows of {size} numbers and a condition number below {WORST:g}, got "
        f"{matrix.tolist()}",
        "one row for each motor that moves more than its own joint, such as coupling = { shoulder = 1, elbow = 1 } "
        "of a belt from the base to the elbow",
    )
    for joint in rigid:
        k = joints.index(joint)
        refuse_if(
            not np.array_equal(matrix[k], own[k]) or not np.array_equal(matrix[:, k], own[k]),
            f"The rigid joint {joint!r} is coupled to others.",
            f"expected a motor that moves it alone, got the coupling {matrix.tolist()}",
            "[joint.spring] with the stiffness of its belt or gear in the place of rigid = true",
        )
    return () if np.array_equal(matrix, own) else tuple(map(tuple, matrix.tolist()))
