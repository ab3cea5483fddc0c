"""Robots, and exact continuous loops around them: the true state is fed back between all samples."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.integrate import solve_ivp

from flexhinf.plant import Parameters
from flexhinf.robot import Robot, load_robot
from flexhinf.robot.dynamics import bodies_of, mass_matrix


def continuous(plant, law, start, duration, reference=None, times=None, disturbance=None, rtol=1e-11):
    """States (N, n) and integrals of ẋ = flow(x, u_d + k(x − x_d, e)), ė = x_i − x_di, to `rtol`."""
    places, data = [plant.index(name) for name in law.integrate], law.law_data

    def at(t):
        return law.equilibrium if reference is None else reference(t)

    def rate(t, z):
        x, e = z[: plant.n], z[plant.n :]
        x_d, u_d = at(t)
        deviation = np.concatenate([x - x_d, e])
        if law.depends_on_reference:
            k = law.evaluate_about(deviation, x_d, u_d, data)
        else:
            k = law.evaluate_law(deviation, data)
        u = np.asarray(u_d + k, dtype=float)
        return np.concatenate([plant.derivative(x, u, disturbance), (x - x_d)[places]])

    times = np.linspace(0.0, duration, 201) if times is None else times
    z = np.concatenate([start, np.zeros(len(places))])
    found = solve_ivp(rate, (0.0, duration), z, method="DOP853", t_eval=times, rtol=rtol, atol=0.1 * rtol)
    assert found.success
    return found.t, found.y.T


def links_at(robot: Robot, q):
    """M(q), and G as a function of q, from the robot's own rigid links (not from its plant's flow)."""
    p = Parameters(robot.plant_parameters())
    tree, mass, centre, inertia = robot.links.rigid(p)
    matrix = np.asarray(mass_matrix(tree, bodies_of(tree, mass, centre, inertia), q), dtype=float)
    return matrix, lambda s: np.asarray(robot.links.gravity_torque(s, p), dtype=float)


def gravity_slope(robot: Robot, q, step=1e-5):
    """∂G/∂q by central differences, (n, n)."""
    _, torque = links_at(robot, q)
    units = step * np.eye(len(q))
    return np.column_stack([(torque(q + unit) - torque(q - unit)) / (2.0 * step) for unit in units])


#: Of the catalogue, by these names.
NAMES = ("paper", "planar-two-link", "spatial-three-link", "seven-link", "quanser", "rig")


@cache
def by_name(name: str) -> Robot:
    """A robot of the catalogue, made once; "quanser" and "rig" for short."""
    return load_robot({"quanser": "quanser-rotflex", "rig": "vertical-rig"}.get(name, name))
