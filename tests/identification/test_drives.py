"""The inner loop of a drive from a log: bandwidth, damping and delay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.builders import robot_named

import flexhinf as fh
from flexhinf.robot import Parameter

PERIOD, LATE = 4e-3, 2
OF_JOINT = ("link_inertia", "stiffness", "motor_inertia", "friction")
LOOP = {"drive_bandwidth": 2.0 * np.pi * 20.0, "drive_damping_ratio": 0.9}


def servo(loop):
    """An arm on a vertical axis, whose drive takes positions."""
    base = robot_named("quanser-rotflex")
    kept = [p for p in base.parameters if p.name in ("mass", "length", "gravity", *OF_JOINT)]
    numbers = [Parameter(name, value) for name, value in loop.items()]
    return replace(base, parameters=(*kept, *numbers), drive="position", effort_limits=None)


@pytest.fixture(scope="module")
def rows():
    """Times, commands and both positions by SciPy's integration of the two equations, commands two periods late."""
    robot, rng = servo(LOOP), np.random.default_rng(2)
    p = robot.plant_parameters()
    times, command = PERIOD * np.arange(450), np.zeros(450)
    for hertz in (0.7, 1.9, 4.3, 8.1):
        command += 0.02 * np.sin(2.0 * np.pi * hertz * times + rng.uniform(0.0, 6.0))
    link, k, inertia, b = (float(np.ravel(p[name])[0]) for name in OF_JOINT)
    w, zeta = LOOP.values()

    def rates(t, x, c):
        twist = k * (x[2] - x[0])
        loop = inertia * (w * w * (c - x[2]) - 2.0 * zeta * w * x[3])
        return [x[1], twist / link, x[3], (loop - b * x[3] - twist) / inertia]

    x, seen = np.zeros(4), []
    for step in range(len(times)):
        seen.append(x[[0, 2]])
        c = command[step - LATE] if step >= LATE else 0.0
        x = solve_ivp(rates, (0.0, PERIOD), x, rtol=1e-8, atol=1e-10, args=(c,)).y[:, -1]
    return times, command, np.array(seen) + rng.normal(0.0, 1e-4, (len(times), 2))


def log_of(rows, late):
    """The log as one says that commands act `late` samples after their row."""
    times, command, seen = rows
    names = {"input": ("position_command",), "output": ("link_position", "motor_position")}
    acting = np.concatenate([np.zeros(late), command[: len(command) - late]])
    return fh.Log(times, acting[:, None], seen, names=names)


@pytest.mark.oracle
@pytest.mark.ci("two identifications of one joint")
def test_bandwidth_and_damping_are_those_of_the_loop_and_a_delay_is_named(rows):
    guess = servo({"drive_bandwidth": 2.0 * np.pi * 14.0, "drive_damping_ratio": 0.6})
    found = fh.identify(guess, log_of(rows, LATE), tuple(LOOP))
    assert found.consistent
    assert found.robot.nominal["drive_bandwidth"] == pytest.approx(found.values["drive_bandwidth"], rel=1e-5)
    for name, value in LOOP.items():
        assert abs(found.values[name] - value) < 3.5 * found.standard_errors[name] < 0.02 * value
    early = fh.identify(guess, log_of(rows, 0), tuple(LOOP))
    assert not early.consistent
    assert early.alternative is not None
    told = early.alternative
    assert (told.signal, told.kind, told.samples) == ("position_command", "late", LATE)
