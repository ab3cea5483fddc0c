"""Arrays for the browser: curves, bands and the moving arm, thinned and packed, in the units that the page shows.

A curve is two arrays of 32-bit floats in base64: 1.6 kB for 300 points. Of 200 robots the page gets five quantiles.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.designs.responses import Response
from flexhinf.robot import Robot, kinematics
from flexhinf.robot.modes import Mode
from flexhinf.studio.preview import Band, LinearParts, Nominal

#: Most points of a curve, and pictures of the arm in one replay.
POINTS, FRAMES = 400, 90

#: Quantiles of a band: the outer two of all robots, the next two of nine robots out of ten, and the median.
QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)

#: How far curves are drawn beyond the step, in steps: those that diverge end there.
BEYOND = 4.0

PlotData = dict[str, Any]


def packed(values: ArrayLike) -> str:
    """32-bit floats, little-endian, in base64; what is not finite is NaN."""
    array = np.asarray(values, dtype=float).ravel()
    with np.errstate(over="ignore"):
        small = np.where(np.abs(array) < 1e30, array, np.nan).astype("<f4")
    return base64.b64encode(small.tobytes()).decode("ascii")


def curve(x: ArrayLike, y: ArrayLike, **style: str | bool) -> PlotData:
    """A line through points."""
    return {"kind": "line", "x": packed(x), "y": packed(y), **style}


def _thinned(length: int) -> np.ndarray:
    """At most `POINTS` places out of so many, with the first and the last."""
    return np.unique(np.linspace(0, length - 1, min(length, POINTS)).astype(int))


class Scales:
    """The units that the page shows of a joint: degrees where the specification is in degrees, else SI."""

    def __init__(self, nominal: Nominal, joint: int) -> None:
        setup = nominal.setup
        self.degrees = setup.specification.in_degrees and not setup.robot.links.slides[joint]
        self.factor = 180.0 / np.pi if self.degrees else 1.0
        self.position = "°" if self.degrees else setup.robot.links.position_units[joint]
        self.effort = setup.limits.effort_units[joint]

    def of_state(self, nominal: Nominal, name: str) -> tuple[float, str]:
        """Factor and unit of an estimated state."""
        unit = nominal.setup.model.unit(name)
        return (180.0 / np.pi, "°" + unit[3:]) if self.degrees and unit.startswith("rad") else (1.0, unit)


# The step, the input, the estimate ------------------------------------------------------------------------
def _clipped(nominal: Nominal, joint: int, positions: np.ndarray, scale: float) -> np.ndarray:
    start, goal = nominal.setup.start[joint], nominal.setup.goal[joint]
    own = nominal.step.positions[:, joint]
    span = max(abs(float(goal - start)), 1e-3 * abs(float(goal)), 1e-6)
    if nominal.step.diverged_at is None:
        span = max(span, float(np.ptp(own)))
    low, high = min(start, goal) - BEYOND * span, max(start, goal) + BEYOND * span
    return scale * np.clip(positions, low, high)


def _step_line(nominal: Nominal, response: Response, joint: int, **style: str | bool) -> PlotData:
    few = _thinned(len(response.run.time))
    y = _clipped(nominal, joint, response.positions[few, joint], Scales(nominal, joint).factor)
    return curve(response.run.time[few], y, **style)


def _input_line(response: Response, joint: int, **style: str | bool) -> PlotData:
    few = _thinned(len(response.run.time))
    return curve(response.run.time[few], response.inputs[few, joint], **style)


def step_series(nominal: Nominal, joint: int) -> dict[str, PlotData | None]:
    """The step of the nominal robot, and the command."""
    scale = Scales(nominal, joint).factor
    goal, command = scale * nominal.setup.goal[joint], nominal.setup.command
    commanded = curve([0.0, nominal.duration], [goal, goal], colour="faint", name="goal")
    if command is not None:
        times = np.linspace(0.0, nominal.duration, POINTS)
        rows = scale * np.reshape(command(times), (len(times), -1))[:, joint]
        commanded = curve(times, rows, colour="faint", name="command")
    own = _step_line(nominal, nominal.step, joint, colour="first", name="nominal robot")
    return {"command": commanded, "nominal": own, "picked": None}


def linear_series(linear: LinearParts, joint: int) -> tuple[PlotData | None, PlotData | None]:
    """Step and input with the linear law; None where the law itself is linear."""
    if linear.step is None:
        return None, None
    style = {"colour": "second", "dash": True, "name": "linear law"}
    return _step_line(linear.nominal, linear.step, joint, **style), _input_line(linear.step, joint, **style)


def band_series(band: Band, joint: int) -> dict[str, PlotData | None]:
    """The band of the sampled robots: all of them, and nine out of ten."""
    samples = band.samples
    if samples is None:
        return {"all": None, "most": None}
    scale = Scales(band.nominal, joint).factor
    rows = _clipped(band.nominal, joint, np.sort(samples.positions[:, :, joint], axis=0), scale)  # NaN last
    counts = np.maximum((~np.isnan(rows)).sum(axis=0), 1)
    places = np.rint(np.outer(QUANTILES, counts - 1)).astype(int)
    low, most_low, _, most_high, high = np.take_along_axis(rows, places, axis=0)
    time = packed(samples.time)

    def filled(y: np.ndarray, top: np.ndarray, name: str) -> PlotData:
        return {
            "kind": "band",
            "x": time,
            "y": packed(y),
            "top": packed(top),
            "colour": "first",
            "name": name,
        }

    return {
        "all": filled(low, high, f"{len(samples)} robots"),
        "most": filled(most_low, most_high, "nine out of ten"),
    }


def effort_series(nominal: Nominal, joint: int) -> dict[str, PlotData | None]:
    """The input of a motor, and its limit."""
    limit = float(nominal.setup.limits.effort[joint])
    ends, bound = [0.0, nominal.duration], {"colour": "limit", "dash": True}
    finite = np.isfinite(limit)
    return {
        "upper": curve(ends, [limit, limit], **bound, name="limit") if finite else None,
        "lower": curve(ends, [-limit, -limit], **bound) if finite else None,
        "nominal": _input_line(nominal.step, joint, colour="first", name="nominal robot"),
        "picked": None,
    }


def estimated_names(nominal: Nominal) -> list[str]:
    """The states whose estimates have a true value; none with the true state fed back."""
    names = nominal.step.run.names
    return [name for name in names["estimate"] if name in names["state"]] if nominal.deviations else []


def error_series(nominal: Nominal, name: str, joint: int) -> dict[str, PlotData | None]:
    """The error of one estimated state, with ±3 standard deviations."""
    if name not in estimated_names(nominal):
        return {"deviation": None, "nominal": None, "picked": None}
    factor, _ = Scales(nominal, joint).of_state(nominal, name)
    three = 3.0 * factor * nominal.deviations[name]
    ends = packed([0.0, nominal.duration])
    return {
        "deviation": {
            "kind": "band",
            "x": ends,
            "y": packed([-three, -three]),
            "top": packed([three, three]),
            "colour": "second",
            "name": "±3σ of the filter",
        },
        "nominal": error_curve(nominal.step, name, factor, colour="first", name="nominal robot"),
        "picked": None,
    }


def error_curve(response: Response, state: str, factor: float, **style: str | bool) -> PlotData:
    """Estimate minus true value of a state."""
    run = response.run
    few, names = _thinned(len(run.time)), run.names
    estimated = run.signals["estimate"][few, names["estimate"].index(state)]
    true = run.signals["state"][few, names["state"].index(state)]
    return curve(run.time[few], factor * (estimated - true), **style)


def picked_series(
    nominal: Nominal, run: Response, joint: int, state: str
) -> tuple[PlotData, PlotData, PlotData | None]:
    """Step, input and estimation error of the run that was picked."""
    style, error = {"colour": "third", "name": "picked robot"}, None
    if state in estimated_names(nominal):
        factor = Scales(nominal, joint).of_state(nominal, state)[0]
        error = error_curve(run, state, factor, **style)
    return _step_line(nominal, run, joint, **style), _input_line(run, joint, **style), error


# The linear loop ---------------------------------------------------------------------------------------------
def sensitivity_series(linear: LinearParts) -> dict[str, PlotData | None]:
    """|S| and |T| at the inputs, largest singular values, over rad/s."""
    if linear.response is None:
        return {"S": None, "T": None, "limit": None}
    found, few = linear.response, _thinned(len(linear.response.frequencies))
    frequencies = found.frequencies[few]
    sizes = [np.linalg.norm(part[few], 2, axis=(1, 2)) for part in (found.sensitivity, found.complementary)]
    limit = linear.nominal.setup.specification.limit("peak_sensitivity")
    return {
        "limit": curve(frequencies[[0, -1]], [limit, limit], colour="limit", dash=True, name="limit of |S|"),
        "T": curve(frequencies, sizes[1], colour="second", name="|T|"),
        "S": curve(frequencies, sizes[0], colour="first", name="|S|"),
    }


def pole_series(linear: LinearParts) -> dict[str, PlotData | None]:
    """Poles of the running loop and of the robot without control, as equivalent continuous ones, 1/s."""
    if linear.failure:
        return {"robot": None, "loop": None}
    evaluation = linear.nominal.evaluation

    def dots(modes: Sequence[Mode], mark: str, **style: str | bool) -> PlotData:
        poles = np.array([mode.eigenvalue for mode in modes], dtype=complex)
        both = np.concatenate([poles, np.conj(poles[np.imag(poles) != 0.0])])
        return {"kind": "dots", "x": packed(np.real(both)), "y": packed(np.imag(both)), "mark": mark, **style}

    return {
        "robot": dots(evaluation.open_modes, "o", colour="faint", name="robot without control"),
        "loop": dots(evaluation.closed_loop_modes, "x", colour="first", name="running loop"),
    }


# The arm ---------------------------------------------------------------------------------------------------------
def arm_frames(nominal: Nominal, response: Response) -> PlotData:
    """The arm along a run: points of its links, where they are, and where they would be with springs that do not give.

    ``links`` and ``motors`` are (F, P, 3), m; ``counts`` says how many of the P points each link has, ``normal`` along
    which axes all joints turn, ``magnified`` how much larger wind-ups are drawn, one of
    ``factors``.
    """
    robot, run = nominal.robot, response.run
    rows = np.unique(np.linspace(0, len(run.time) - 1, FRAMES).astype(int))
    n, state = len(robot.joint_names), run.signals["state"][rows]
    links, motors = state[:, :n], robot.layout.relaxed(state.T).T
    usable = np.isfinite(links).all(axis=1) & np.isfinite(motors).all(axis=1)
    rows, links, motors = rows[usable], links[usable], motors[usable]
    goal, seen = kinematics.skeleton(robot, nominal.setup.goal), kinematics.picture_axes(robot)
    size = float(np.ptp(np.concatenate(goal), axis=0).max())
    windup = motors - links if len(rows) else np.zeros((1, n))
    return {
        "time": packed(run.time[rows]),
        "links": packed(_points(robot, links)),
        "motors": packed(_points(robot, motors)),
        "counts": [len(line) for line in goal],
        "goal": packed(_points(robot, nominal.setup.goal[None, :])),
        "magnified": kinematics.magnification(windup, robot.links.slides, size),
        "factors": kinematics.FACTORS,
        "normal": None if seen is None else (_axes(robot) @ np.cross(*seen.axes.T)).tolist(),
    }


def _points(robot: Robot, poses: np.ndarray) -> np.ndarray:
    """Points (F, P, 3) of the links at poses (F, n), m, in the drawing's `_axes`."""
    return np.array([np.concatenate(kinematics.skeleton(robot, pose)) for pose in poses]) @ _axes(robot).T


def _axes(robot: Robot) -> np.ndarray:
    """Axes (3, 3) of the drawing, by rows, of which the third points away from free fall."""
    up = -np.asarray(robot.links.down, dtype=float)
    across = np.eye(3)[int(abs(up[0]) > 0.9)]
    across = across - (across @ up) * up
    across /= np.linalg.norm(across)
    return np.array([across, np.cross(up, across), up])
