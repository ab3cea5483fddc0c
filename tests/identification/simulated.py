"""Logs whose truth is known: a plant with random disturbances and measurement noise, sampled."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

import flexhinf as fh

PERIOD = 0.01

TRUE = {"stiffness": 40.0, "damping": 0.8, "gain": 1.5}


def share(trials):
    """Least and largest share of intervals that hold: 92 to 98 %, or three standard deviations where these are more."""
    spread = 3.0 * np.sqrt(0.95 * 0.05 / trials)
    return min(0.92, 0.95 - spread), max(0.98, 0.95 + spread)


def oscillator(**values):
    return fh.Plant(
        lambda x, u, d, p: np.array([x[1], -p.stiffness * x[0] - p.damping * x[1] + p.gain * u[0] + d[0]]),
        lambda x, u, p: x[:1],
        ("position", "velocity"), ("force",), ("load",), {**TRUE, **values}, ("position",),
    )  # fmt: skip


def undisturbed(measured=("position",)):
    """The oscillator without a disturbance, its position or velocity or both measured."""
    rows = {"position": [1.0, 0.0], "velocity": [0.0, 1.0]}
    return fh.Plant(
        lambda x, u, d, p: np.array([x[1], -p.stiffness * x[0] - p.damping * x[1] + u[0]]),
        lambda x, u, p: np.array([np.dot(rows[name], x) for name in measured]),
        ("position", "velocity"), ("force",), parameters={"stiffness": 40.0, "damping": 0.3}, outputs=measured,
    )  # fmt: skip


def excitation(times):
    return 4.0 * np.sin(2.0 * times) + 3.0 * np.sin(5.3 * times) + 3.0 * np.sign(np.sin(7.9 * times))


def linear_log(seed, count=600, noise=0.01, level=0.1, **values):
    """Times, inputs and outputs of the oscillator by its exact transition, `level` (1/√s) of white force."""
    rng, p = np.random.default_rng(seed), {**TRUE, **values}
    drift = np.array([[0.0, 1.0], [-p["stiffness"], -p["damping"]]])
    whole = expm(PERIOD * np.block([[drift, np.array([[0.0], [p["gain"]]])], [np.zeros((1, 3))]]))
    times = PERIOD * np.arange(count)
    u, x, rows = excitation(times), rng.normal(size=2) * [0.2, 0.5], []
    for k in range(count):
        rows.append(x[0] + noise * rng.normal())
        x = whole[:2, :2] @ x + whole[:2, 2] * u[k] + [0.0, level * np.sqrt(PERIOD) * rng.normal()]
    return times, u[:, None], np.array(rows)[:, None]


def arm_log(robot, seed=0, count=3000, noise=1e-4, measured=("link_position", "motor_position"), period=1e-3):
    """The same of a robot, by short Runge–Kutta steps, without disturbances, from rest."""
    rng, plant = np.random.default_rng(seed), robot.plant(measured)
    times = period * np.arange(count)
    u = 8.0 * np.sin(3.0 * times) + 5.0 * np.sin(11.0 * times) + 3.0 * np.sin(23.0 * times)
    x, rows, p, h = np.zeros(plant.n), [], plant.parameters.vector(), period / 2.0
    still = np.zeros(len(plant.disturbances))
    for k in range(count):
        rows.append(plant.evaluate_output(x, u[k : k + 1], p))
        for _ in range(2):
            a = plant.evaluate_flow(x, u[k : k + 1], still, p)
            b = plant.evaluate_flow(x + h / 2 * a, u[k : k + 1], still, p)
            c = plant.evaluate_flow(x + h / 2 * b, u[k : k + 1], still, p)
            x = x + h / 6 * (a + 2 * b + 2 * c + plant.evaluate_flow(x + h * c, u[k : k + 1], still, p))
    return times, u[:, None], np.array(rows) + noise * rng.normal(size=(count, len(measured)))
