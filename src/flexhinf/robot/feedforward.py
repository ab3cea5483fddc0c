"""Inverse dynamics of elastic joints: the state and the input of a motion of the links, [deluca2016].

The link positions are a flat output of Spong's model: q and its first four derivatives give all else.

    τ_J = M(q) q̈ + C(q, q̇) q̇ + G(q)        θ = q + K⁻¹ τ_J
    J θ̈ + B θ̇ + F(θ̇) + τ_J = τ              τ = k_t (V − k_b θ̇) / R

The derivatives of τ_J are exact: the Newton–Euler recursion runs on power series in time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant.parameters import ParameterTable
from flexhinf.robot.elastic import Layout, Links
from flexhinf.robot.extras import friction_torque
from flexhinf.scalars import derivative, series, trace
from flexhinf.untrusted import real_array

#: What a real joint adds that the inverse dynamics can follow: torques on the motor that its velocity gives.
MODELLED = ("coulomb_friction", "stribeck_friction")

WHY_NOT = {
    "inductance": "the coil needs a fifth derivative",
    "joint_damping": "a damped spring takes away the flat output: its twist obeys a differential equation",
    "spring_hardening": "the spring would have to be inverted at each time",
    "backlash": "a spring with a dead zone has no inverse",
}

ORDERS = ("q", "dq", "ddq", "dddq", "ddddq")


@dataclass(frozen=True)
class InverseFlow:
    """(q, q̇, q̈, q⃛, q⁗) → (x, u) with ẋ = flow(x, u, 0, p) of `ElasticFlow`, on any element.

    With q⁗ = v a law's wish, u is the input of exact feedback linearisation [spong1987].

    Parameters
    ----------
    drive : {"voltage", "current", "torque"}
    extras : sequence of str
        Out of `MODELLED`.
    rigid : tuple of int
        Joints without a spring: J q̈ + B q̇ + F(q̇) + τ_J = τ.

    Raises
    ------
    InvalidInput
        For an extra that it cannot follow, by name.
    """

    links: Links
    drive: str = "voltage"
    extras: tuple[str, ...] = ()
    rigid: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for name in self.extras:
            if name not in MODELLED:
                raise InvalidInput(
                    f"The inverse dynamics do not model {name!r}: {WHY_NOT.get(name, 'it is unknown')}.",
                    f"expected extras out of {list(MODELLED)}, got {list(self.extras)}",
                    f"the feedforward without {name!r}; the law feeds back what it leaves",
                )

    def __call__(self, q: Any, dq: Any, ddq: Any, dddq: Any, ddddq: Any, p: Any) -> tuple[Any, Any]:
        """State (4n,) and input (n,) from link positions and four derivatives, (n,) each."""
        torque = self.links.torques(
            series(q, dq, ddq), series(dq, ddq, dddq), series(ddq, dddq, ddddq), p
        )  # fmt: skip
        load, rate, jerk = (derivative(torque, order) for order in range(3))
        layout = Layout(len(self.links.joint_names), self.rigid)
        softness, links, torques = 1.0 / p.stiffness, (q, dq, ddq), (load, rate, jerk)
        if self.rigid:
            links, torques = (tuple(v[layout.elastic] for v in part) for part in (links, torques))
        own = [at + softness * twisting for at, twisting in zip(links, torques)]
        _, speed, acceleration = (layout.motors(at, motor) for at, motor in zip((q, dq, ddq), own))
        drive = p.motor_inertia * acceleration + p.friction * speed + load
        if self.extras:
            drive = drive + friction_torque(speed, p, self.extras)
        if self.drive == "current":
            drive = (1.0 / p.torque_constant) * drive
        elif self.drive == "voltage":
            drive = (p.resistance / p.torque_constant) * drive + p.back_emf_constant * speed
        return np.concatenate([q, dq, own[0], own[1]]), drive


def flat_coordinates(links: Links, x: Any, p: Any, layout: Layout) -> tuple[Any, Any, Any, Any]:
    """(q, q̇, q̈, q⃛), (n,) each, of an undisturbed state x = (q1, q̇1, q2, q̇2), on any element.

    They are the coordinates in which `InverseFlow` makes the robot n chains of four integrators.

    Raises
    ------
    InvalidInput
        For a robot with rigid joints, whose accelerations depend on the input.
    """
    if layout.rigid:
        raise InvalidInput(
            "A robot with rigid joints has no flat coordinates: its state alone does not give q̈ and q⃛.",
            f"expected elastic joints only, got the rigid {[links.joint_names[i] for i in layout.rigid]}",
            "a law without exact linearisation",
        )
    q, dq, theta, dtheta = layout.split(x)
    spring, rate = p.stiffness * (theta - q), p.stiffness * (dtheta - dq)
    ddq = links.accelerations(q, dq, spring, p)
    moved = links.accelerations(series(q, dq), series(dq, ddq), series(spring, rate), p)
    return q, dq, ddq, derivative(moved, 1)


def state_and_input(
    flow: InverseFlow, values: Mapping[str, Any], motion: tuple[np.ndarray, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """x (N, 4n) and u (N, n) of rows (N, n) of positions and four derivatives.

    Parameters
    ----------
    values : mapping of str to float or array
        Parameters of the plant.
    motion : five (N, n) arrays
    """
    table = ParameterTable(values)
    shapes = tuple((name, value.shape) for name, value in table.values.items())
    count = len(motion[0])
    if not count:
        n = motion[0].shape[1]
        return np.zeros((0, Layout(n, flow.rigid).mechanical)), np.zeros((0, n))
    numbers = np.broadcast_to(table.vector()[:, None], (table.size, count))
    x, u = _traced(flow, shapes)(*(rows.T for rows in motion), numbers)
    return np.array(x, dtype=float).T, np.array(u, dtype=float).T


@lru_cache(maxsize=64)
def _traced(flow: InverseFlow, shapes: tuple[tuple[str, tuple[int, ...]], ...]) -> Any:
    """As a CasADi function of (q, q̇, q̈, q⃛, q⁗, parameter vector): other parameters trace nothing again."""
    table = ParameterTable({name: np.zeros(shape) for name, shape in shapes})
    n = len(flow.links.joint_names)

    def inverse(q: Any, dq: Any, ddq: Any, dddq: Any, ddddq: Any, vector: Any) -> tuple[Any, Any]:
        return flow(q, dq, ddq, dddq, ddddq, table.named(vector))

    return trace(inverse, *(n,) * 5, table.size, name="inverse", names=(*ORDERS, "p"))


def motion_rows(motion: tuple[Any, ...], joints: tuple[str, ...]) -> tuple[tuple[np.ndarray, ...], bool]:
    """Positions and derivatives as five (N, n) arrays, and whether they were one point; None is zero.

    Raises
    ------
    InvalidInput
        For numbers that are not finite, or shapes that do not fit.
    """
    arrays = []
    for name, value in zip(ORDERS, motion):
        array = np.zeros(len(joints)) if value is None else np.atleast_1d(real_array(value))
        if array.ndim not in (1, 2) or array.shape[-1] != len(joints) or not np.all(np.isfinite(array)):
            raise InvalidInput(
                f"The motion's {name} does not fit the robot.",
                f"expected finite numbers, ({len(joints)},) or (N, {len(joints)}) for {list(joints)}, "
                f"got {_shown(value, array)}",
                "one column per joint, one row per time",
            )
        arrays.append(array)
    counts = {len(array) for array in arrays if array.ndim == 2}
    if len(counts) > 1:
        raise InvalidInput(
            "The motion's derivatives have different numbers of times.",
            f"expected one, got {[array.shape for array in arrays]}",
            "one row per time in each",
        )
    count = counts.pop() if counts else 1
    rows = tuple(np.broadcast_to(array, (count, len(joints))) for array in arrays)
    return rows, all(array.ndim == 1 for array in arrays)


def _shown(value: Any, array: np.ndarray) -> str:
    if array.size > 8:
        return f"shape {array.shape}" + ("" if np.all(np.isfinite(array)) else ", not all finite")
    return repr(value)
