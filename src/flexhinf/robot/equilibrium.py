"""Parameters of plants, with the equilibrium of each: of one robot, or of many that differ in their numbers.

Many robots are computed at once, with the bits that each of them has alone.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from flexhinf.arrays import Number
from flexhinf.plant import Parameters
from flexhinf.robot.arm import Links, Pendulum
from flexhinf.robot.drives import DRIVES
from flexhinf.robot.elastic import reflected
from flexhinf.robot.gears import curve_softness, curve_torque, curve_twist, meshed, tooth_error, tooth_ripple
from flexhinf.robot.layout import Layout
from flexhinf.robot.parameters import PlantValues

#: A torque (force) of less than this times the robot's weight, at a metre, is rounding.
ROUNDING = 1e-12


def plant_columns(
    links: Links,
    drive: str,
    joints: Sequence[str],
    rigid: Sequence[str],
    values: Mapping[str, Number],
    shape: tuple[int, ...],
) -> PlantValues:
    """Parameters of N plants, (N, …), from the parameters of robots by name: a number for all, or (N,) of each."""

    def column(value: Number) -> np.ndarray:
        return np.broadcast_to(np.asarray(value, dtype=float), shape)

    columns = {name: column(value) for name, value in values.items()}
    arrays = {
        name: np.moveaxis(np.array([*map(column, parts)]).reshape(-1, *shape), 0, -1)
        for name, parts in reflected(columns, drive, joints, rigid).items()
    }
    if isinstance(links, Pendulum):
        arrays = {name: array[..., 0] for name, array in arrays.items()}
    return PlantValues(links.packed_columns(columns) | arrays, columns)


def equilibrium(
    links: Links,
    drive: str,
    layout: Layout,
    q: np.ndarray,
    packed: Mapping[str, Any],
    on: Collection[str],
) -> tuple[np.ndarray, np.ndarray]:
    """State and input at rest with links at q (n,): q2 = T q1 + K⁻¹ T⁻ᵀ G(q1), exactly, with T of `Layout`.

    With the curve of a gear, q2 = q1 + δ(G). `packed` are the parameters of the plant, `on` its extras. Of N robots,
    joints are in the first axis of each array and robots in the last one.
    """
    p = Parameters(packed)
    elastic, at = layout.elastic, layout.at_motors(q)
    held = layout.on_motors(links.gravity_torque(q, p))
    weight, stiffness = np.asarray(held)[elastic], np.atleast_1d(p.stiffness)
    curve = "stiffness_curve" in on
    twist = curve_twist(weight, p) if curve else weight / stiffness
    if "spring_hardening" in on:
        # T(δ) + K₃ δ³ = G, each joint by Newton's method from outside: it falls to the only root.
        cubic, done = np.atleast_1d(p.spring_hardening), np.array(False)
        for _ in range(100):
            torque, slope = stiffness * twist, stiffness
            if curve:
                torque = curve_torque(twist, p)
                slope = 1.0 / curve_softness(torque, p)
            step = (torque + cubic * twist**3 - weight) / (slope + 3.0 * cubic * twist**2)
            twist = np.where(done, twist, twist - step)
            done = done | np.all(np.abs(step) <= 1e-16 * np.abs(twist), axis=0)
            if np.all(done):
                break
    if "backlash" in on:
        # A joint that carries nothing may stand anywhere in its gap: in the middle, not where rounding pushes it.
        mass = np.sum(np.atleast_1d(p.mass), axis=0)
        twist = (
            twist + 0.5 * np.sign(weight) * (np.abs(weight) > ROUNDING * mass * abs(p.gravity)) * p.backlash
        )
    held, motors = np.array(held, dtype=float), at[elastic] + twist
    if "kinematic_error" in on:
        ratio = np.atleast_1d(p.gear_ratio)[elastic]
        motors = meshed(motors, ratio, p)
        twist = motors - at[elastic]
        held[elastic] *= 1.0 + tooth_error(motors, ratio, p)[1]
    if "torque_ripple" in on:
        turned = np.array(at, dtype=float)
        turned[elastic] = motors
        held = held + tooth_ripple(turned, p)
    still = np.zeros(q.shape)
    kind, states = DRIVES[drive], [q, still, motors, still[elastic]]
    effort = np.array(kind.holding_input(held, p), dtype=float)
    if kind.takes_positions:
        effort = effort + at
        effort[elastic] += twist
    if "inductance" in on:
        states.append(np.asarray(kind.coil_currents(held, p), dtype=float))
    return np.concatenate(states), effort
