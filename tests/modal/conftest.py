"""Robots and modal laws, made once; and the linear sampled loop of a law with the true state and a latency."""

from __future__ import annotations

import warnings
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from benchmarks.hardware.robots import files_of
from scipy.linalg import expm

from flexhinf.modal import ModalLaw
from flexhinf.robot import RobotFileWarning, load_robot

PERIOD = 1e-3


@lru_cache
def known_robot(name):
    if name not in ("panda", "ur5"):
        return load_robot(name)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RobotFileWarning)  # foreign attributes are told
            return load_robot(*map(str, files_of(name)))
    except FileNotFoundError as missing:
        pytest.skip(f"missing: {missing}")


@lru_cache
def problem_of(name):
    return known_robot(name).problem(penalty={"link_position": 1.0, "link_position_integral": 1.0})


@lru_cache
def tuned_law(name):
    return ModalLaw.tuned(problem_of(name), PERIOD)


def law_slope(law, x, u):
    """∂k/∂x (m, 5n) about a reference."""
    units = np.eye(len(law.state_names))
    columns = [law.evaluate_about(unit, x, u, law.law_data) for unit in units]
    return np.array(columns, dtype=float).T


def held(a, b, duration):
    n, m = b.shape
    whole = expm(np.block([[a, b], [np.zeros((m, n + m))]]) * duration)
    return whole[:n, :n], whole[:n, n:]


def sampled_loop(a, b, gain, latency, places, period=PERIOD):
    """Matrix of (x, integral, last tracked, waiting inputs) with u acting `latency` samples after its measurement, the
    state predicted over them; the integral counts the measured error by the trapezoidal rule."""
    (n, m), k = b.shape, len(places)
    f, g = held(a, b, period)
    size = n + 2 * k + latency * m
    waiting = [slice(n + 2 * k + i * m, n + 2 * k + (i + 1) * m) for i in range(latency)]  # the oldest first
    read = np.eye(n, size)
    for place in waiting:
        read = f @ read
        read[:, place] += g
    position = np.eye(n, size)[places]
    integral = np.eye(k, size, n) + 0.5 * period * (np.eye(k, size, n + k) + position)
    u = gain[:, :n] @ read + gain[:, n:] @ integral
    loop = np.zeros((size, size))
    loop[:n, :n] = f
    if latency:
        loop[:n, waiting[0]] += g
        loop[waiting[-1]] = u
        for older, newer in pairwise(waiting):
            loop[older, newer] = np.eye(m)
    else:
        loop[:n] += g @ u
    loop[n : n + k], loop[n + k : n + 2 * k] = integral, position
    return loop
