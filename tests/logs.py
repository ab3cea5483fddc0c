"""Logs whose truth is known: a plant with random disturbances and measurement noise, sampled."""

from __future__ import annotations

import casadi
import numpy as np
from scipy.linalg import expm

import flexhinf as fh
from flexhinf.loop.simulation.program import rk4_function

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
        units={"position": "m", "velocity": "m/s", "force": "N"},
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


def recorded(plant, inputs, period=1e-3, noise=1e-4, seed=0, start=None):
    """Times, inputs and noisy outputs of a plant without disturbances, by two Runge–Kutta steps a sample, from rest."""
    u, p = np.reshape(inputs, (len(inputs), -1)), plant.parameters.vector()
    half = rk4_function(plant)
    x, v = casadi.SX.sym("x", plant.n), casadi.SX.sym("u", u.shape[1])
    given = np.zeros(3 * len(plant.disturbances)), casadi.DM([period / 2.0, *p])
    step = casadi.Function("sample", [x, v], [half(half(x, v, *given), v, *given)]).mapaccum(len(u))
    start = np.zeros(plant.n) if start is None else np.asarray(start)
    states = np.vstack([start, np.asarray(step(start, u.T)).T[:-1]])
    y = np.array([plant.evaluate_output(x, v, p) for x, v in zip(states, u, strict=True)])
    return period * np.arange(len(u)), u, y + noise * np.random.default_rng(seed).normal(size=y.shape)


def arm_log(robot, seed=0, count=3000, noise=1e-4, measured=("link_position", "motor_position"), period=1e-3):
    """A log of a robot of one joint, whose voltage is a sum of three sines."""
    times = period * np.arange(count)
    volts = 8.0 * np.sin(3.0 * times) + 5.0 * np.sin(11.0 * times) + 3.0 * np.sin(23.0 * times)
    return recorded(robot.plant(measured), volts, period, noise, seed)


#: R^v and R^n of `noisy_log`.
Q, R = np.diag([1e-6, 1e-3]), 1e-4


def noisy_log(seed=0, count=2000):
    """Positions of the `undisturbed` oscillator with the noises Q and R and its true states, by SciPy's exponential.

    That is the linear system whose exact map differs from the filter's own by O(T²).
    """
    rng, step = np.random.default_rng(seed), expm(PERIOD * np.array([[0.0, 1.0], [-40.0, -0.3]]))
    x, states = np.array([0.1, 0.0]), []
    for _ in range(count):
        states.append(x)
        x = step @ x + rng.multivariate_normal(np.zeros(2), Q)
    y = np.array(states)[:, 0] + np.sqrt(R) * rng.normal(size=count)
    return fh.Log(PERIOD * np.arange(count), np.zeros(count), y, np.array(states))


def noisy_filter(q=1.0, r=1.0, form="square_root"):
    """A filter of `noisy_log` with q times Q and r times R."""
    return fh.ExtendedKalmanFilter(undisturbed(), PERIOD, q * Q, r * R, [0.1, 0.0], 1e-8, form=form)


def write_log(path, names, *columns):
    """A CSV file of these columns, its head "time" and the names, with every digit."""
    head = ",".join(["time", *names])
    np.savetxt(path, np.column_stack(columns), "%.17g", ",", header=head, comments="")
    return path


#: Robots of healthy logs, with the size of their input, its unit.
HEALTHY = {"paper": 8.0, "quanser-rotflex": 3.0, "vertical-rig": 0.15}


def healthy_log(seed):
    """A robot and a log with nothing wrong: encoders of 9 to 20 bits, 100 Hz to 2 kHz, at rest, slow or fast.

    The noise is up to half a step, stamps jitter by up to 2 %, a torque of 0.2 % of the input is unknown; in a third of
    the logs a row in a hundred is missing.
    """
    rng = np.random.default_rng(seed)
    name = list(HEALTHY)[seed % len(HEALTHY)]
    robot, size = fh.load_robot(name), HEALTHY[name]
    period = 1.0 / np.exp(rng.uniform(np.log(100.0), np.log(2000.0)))
    count, way = int(rng.integers(600, 2000)), ("rest", "slow", "fast")[seed // len(HEALTHY) % 3]
    measured = (("motor_position",), ("link_position",), ("motor_position", "link_position"))[rng.integers(3)]
    times = period * np.arange(count)
    length = times[-1]
    u = np.zeros(count)
    if way != "rest":
        lows = {"slow": (0.5, 3.0), "fast": (2.0, 20.0)}[way]
        for frequency in rng.uniform(*lows, size=3) / length * 2.0 * np.pi:
            u += size / 3.0 * np.sin(frequency * times + rng.uniform(0.0, 2.0 * np.pi))
        u += 0.3 * size * np.sign(np.sin(2.0 * np.pi * rng.uniform(1.0, 4.0) * times / length))
    acting = u + 0.002 * size * rng.normal(size=count)
    start = np.zeros(4) if way != "rest" else np.full(4, 0.0)
    _, _, y = recorded(robot.plant(measured), acting, period, 0.0, seed, start)
    steps = 2.0 * np.pi / 2.0 ** rng.integers(9, 21, size=len(measured))
    y = steps * np.rint(y / steps + rng.uniform(0.0, 0.5) * rng.normal(size=y.shape))
    times = times + 0.02 * period * rng.uniform(-1.0, 1.0, size=count)
    kept = rng.random(count) > 0.01 * (rng.random() < 1.0 / 3.0)
    names = {"input": robot.plant().inputs, "output": measured}
    return robot, fh.Log(times[kept] - times[kept][0], u[kept], y[kept], names=names), way
