"""Small plants, laws, black boxes, filters, controllers and logs that the tests of all rooms share.

A test that judges other numbers states them; what never changes is made once for a process.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import combinations, product
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.baselines import lqr
from flexhinf.designs.laws import NL_HINF
from flexhinf.designs.numbers_file import VERSION
from flexhinf.designs.requirements import Requirement
from flexhinf.plant import BlackBox, Law, Plant, rk4_step
from flexhinf.robot import Parameter


# Cases ------------------------------------------------------------------------------------------------------
def pairs(*options: Sequence[Any]) -> list[tuple[Any, ...]]:
    """So few cases, always the same, that every two levels of two options meet in one of them."""

    def met(case: tuple[int, ...]) -> set[Any]:
        return set(combinations(enumerate(case), 2))

    every = list(product(*(range(len(levels)) for levels in options)))
    missing, chosen = set[Any]().union(*map(met, every)), []
    while missing:
        chosen.append(max(every, key=lambda case: len(met(case) & missing)))
        missing -= met(chosen[-1])
    return [tuple(levels[k] for levels, k in zip(options, case, strict=True)) for case in chosen]


#: Both Kalman filters, and the forms in which each keeps its covariance.
KALMAN = pytest.mark.parametrize("kind", [fh.UnscentedKalmanFilter, fh.ExtendedKalmanFilter])
FORMS = pytest.mark.parametrize("form", ["covariance", "square_root"])

#: Every way to keep what a Kalman filter believes.
FILTERS: dict[str, Any] = {
    "ukf": fh.UnscentedKalmanFilter,
    "ukf, rows": partial(fh.UnscentedKalmanFilter, form="square_root"),
    "points kept": partial(fh.UnscentedKalmanFilter, redraw=False),
    "ekf": fh.ExtendedKalmanFilter,
    "ekf, rows": partial(fh.ExtendedKalmanFilter, form="square_root"),
}


def filters(*names: str, **more: Any) -> pytest.MarkDecorator:
    """Parametrizes `kind` by those of `FILTERS` with these names, or by all, and by others that are given."""
    kinds = {name: FILTERS[name] for name in names or FILTERS} | more
    return pytest.mark.parametrize("kind", kinds.values(), ids=kinds)


#: Both filters in both forms.
KALMAN_FORMS = filters("ukf", "ukf, rows", "ekf", "ekf, rows")


# Plants -----------------------------------------------------------------------------------------------------
def linear_plant(a: Any, b: Any, c: Any = None, **names: Any) -> Plant:
    """ẋ = A x + B u, or x⁺ with `sampled=True`; y = C x, or x. A, B and C are its parameters.

    States are x0, x1, … and inputs u0, u1, … if `states` and `inputs` do not name them.
    """
    a, b = (np.atleast_2d(np.asarray(matrix, dtype=float)) for matrix in (a, b))
    c = np.eye(len(a)) if c is None else np.atleast_2d(np.asarray(c, dtype=float))
    given = {
        "states": [f"x{k}" for k in range(len(a))],
        "inputs": [f"u{k}" for k in range(b.shape[1])],
        **names,
    }
    return Plant(
        lambda x, u, d, p: p.a @ x + p.b @ u, lambda x, u, p: p.c @ x, parameters={"a": a, "b": b, "c": c}, **given
    )  # fmt: skip


def forced_pendulum(outputs: Sequence[str] = ("angle_seen",), **options: Any) -> Plant:
    """A damped pendulum, pushed by a torque and by wind, whose angle is measured, perhaps its speed too."""
    count = len(outputs)
    return Plant(
        lambda x, u, d, p: np.array([x[1], -p.pull * np.sin(x[0]) - 0.3 * x[1] + u[0] + d[0]]),
        lambda x, u, p: x[:count],
        ("angle", "speed"), ("torque",), ("wind",), {"pull": 4.0}, tuple(outputs), **options,
    )  # fmt: skip


def bearing(**options: Any) -> Plant:
    """A pendulum that is seen by a direction and by a product of its states, neither of them linear."""
    return Plant(
        lambda x, u, d, p: np.array([x[1], -p.weight * np.sin(x[0]) + u[0]]),
        lambda x, u, p: np.array([np.arctan2(x[1], 2.0 + x[0]), x[0] * x[1]]),
        ("angle", "speed"), ("torque",), outputs=("bearing", "product"), parameters={"weight": 1.0}, **options,
    )  # fmt: skip


def three_sensors(places: Sequence[int] = (0, 1, 2)) -> Plant:
    """Three states and three sensors that are not linear, or some of them."""

    def output(x: Any, u: Any, p: Any) -> Any:
        every = [np.arctan2(x[1], 2.0 + x[0]), p.scale * x[0] * x[1] + u[0], x[2] + 0.2 * np.sin(x[0])]
        return np.array([every[k] for k in places])

    return Plant(
        lambda x, u, d, p: np.array([x[1], -np.sin(x[0]) + u[0], -x[2] + x[0] ** 2]),
        output, ("x0", "x1", "x2"), ("u",), parameters={"scale": 1.3},
    )  # fmt: skip


def runge_kutta(rate: Callable[[Any], Any], x: Any, step: float) -> Any:
    """One step of the classical method on ẋ = rate(x), written here: loops are compared with it."""
    a = rate(x)
    b = rate(x + step / 2.0 * a)
    c = rate(x + step / 2.0 * b)
    return x + step / 6.0 * (a + 2.0 * b + 2.0 * c + rate(x + step * c))


# Laws and black boxes ---------------------------------------------------------------------------------------
class LinearLaw(Law):
    """u = u* + K (x − x*), the smallest thing that is a law."""

    law_key: Any = "linear"

    def __init__(
        self, states: Sequence[str], inputs: Sequence[str], gain: Any, point: Any = None, rest: Any = None
    ) -> None:
        self.state_names, self.input_names = tuple(states), tuple(inputs)
        self.gain = np.atleast_2d(np.asarray(gain, dtype=float))
        self.operating_point = np.zeros(len(self.state_names)) if point is None else np.asarray(point)
        self.operating_input = np.zeros(len(self.input_names)) if rest is None else np.asarray(rest)

    @property
    def law_data(self) -> Any:
        return self.gain.ravel()

    def evaluate_law(self, x: Any, data: Any) -> Any:
        return np.asarray(data).reshape(len(self.input_names), -1) @ x


def linear_law(
    plant: Plant, gain: Any, point: Any = None, rest: Any = None, integrals: Sequence[str] = ()
) -> LinearLaw:
    """u = u* + K (x − x*) with the states of a plant, then integrals of these signals, whose rest is 0."""
    names = (*plant.states, *(f"{name}_integral" for name in integrals))
    whole = None if point is None else np.concatenate([point, np.zeros(len(integrals))])
    return LinearLaw(names, plant.inputs, gain, whole, rest)


def still(plant: Plant) -> LinearLaw:
    """No input at all."""
    return linear_law(plant, np.zeros((len(plant.inputs), plant.n)))


class PlantBox(BlackBox):
    """A plant as a black box that integrates itself, in so many steps of Runge and Kutta a period.

    `seen` makes what is measured of the state, (n,) → (p,); else it is the plant's output.
    """

    def __init__(
        self, plant: Plant, parts: int = 1, start: Any = None, seen: Callable[[Any], Any] | None = None
    ) -> None:
        self.plant, self.parts, self.start, self.seen = plant, parts, start, seen
        self.states, self.disturbances = plant.states, plant.disturbances

    def reset(self, initial_state: Any) -> None:
        start = self.start if initial_state is None else initial_state
        self.x = np.zeros(self.plant.n) if start is None else np.array(start, dtype=float)
        self.u = np.zeros(len(self.plant.inputs))

    def step(self, u: Any, disturbance: Any, period: float) -> None:
        pushed = disturbance if len(disturbance) else None
        for _ in range(self.parts):
            self.x = rk4_step(
                lambda x, u: self.plant.derivative(x, u, pushed), self.x, (u,) * 3, period / self.parts
            )
        self.u = u

    def output(self) -> Any:
        if self.seen is not None:
            return self.seen(self.x)
        return np.asarray(
            self.plant.evaluate_output(self.x, self.u, self.plant.parameters.vector()), dtype=float
        )

    def state(self) -> Any:
        return self.x


# Robots -----------------------------------------------------------------------------------------------------
def joint_text(
    name: str, *, mass: float | None = 1.0, centre: Any = (0.0, 0.0, 0.1), inertia: Any = (0.02, 0.02, 0.01),
    spring: str = "stiffness = 100.0", motor: str = "motor_inertia = 0.1", **keys: Any,
) -> str:  # fmt: skip
    """A [[joint]] of a robot file: `keys` stand at its top; `spring` and `motor` are the lines of these tables.

    `inertia` is xx, yy, zz and perhaps xy. Without a mass the joint has no link, as beside a URDF.
    """
    lines = [
        "[[joint]]",
        f'name = "{name}"',
        *(f"{key} = {json.dumps(value)}" for key, value in keys.items()),
    ]
    if mass is not None:
        parts = ", ".join(f"{axis} = {value}" for axis, value in zip(("xx", "yy", "zz", "xy"), inertia))
        lines += [
            "[joint.link]",
            f"mass = {mass}",
            f"centre_of_mass = {list(centre)}",
            f"inertia = {{ {parts} }}",
        ]
    return "\n".join([*lines, "[joint.spring]", spring, "[joint.motor]", motor, ""])


# Filters and controllers ------------------------------------------------------------------------------------
#: A robot of the catalogue by its name, loaded once: robots do not change.
robot_named = cache(fh.load_robot)


def driven_robot(
    name: str, drive: str = "position", hertz: Sequence[float] = (20.0, 20.0), share: float = 1.0
) -> fh.Robot:
    """A robot of the catalogue whose drives have an inner loop of these bandwidths, Hz, and no limit."""
    robot = robot_named(name)
    constants = ("torque_constant", "resistance", "back_emf_constant", "inductance")
    numbers = [p for p in robot.parameters if not p.name.startswith(constants)]
    for joint, bandwidth in zip(robot.joint_names, hertz, strict=True):
        loop = {"drive_bandwidth": 2.0 * math.pi * bandwidth, "load_share": share}
        loop |= {"drive_damping_ratio": 0.9} if drive == "position" else {}
        numbers += [Parameter(f"{key}_{joint}", value) for key, value in loop.items()]
    return replace(robot, parameters=tuple(numbers), drive=drive, effort_limits=None)


def arm_law(robot: fh.Robot, degree: int = 2, *given: Any, **options: Any) -> Any:
    """The law of `robot.problem(*given, **options)` for γ = ∞: the linear one, or that of a V of higher degree."""
    problem = robot.problem(*given, **options)
    if degree == 2:
        return fh.linear_law(problem, gamma=math.inf)
    return fh.solve_hji(problem, gamma=math.inf, degree=degree)


def arm_controller(
    name: str | fh.Robot = "paper", kind: Any = fh.UnscentedKalmanFilter, *, degree: int = 2, weights: Any = None,
    pose: Any = None, at: Any = None, mean: Any = None, measured: Any = None, q: Any = 1e-7, r: Any = 1e-4,
    p0: Any = 1e-4, period: float = 1e-3, limit: Any = 48.0, filter: Any = None, **options: Any,
) -> fh.Controller:  # fmt: skip
    """A controller of a robot, or of one of the catalogue, at 1 kHz and with inputs of 48 at most.

    `arm_law` about a pose stands behind a filter of this kind, or behind none (None). The filter begins at rest at
    the pose or `at` other angles, or with a mean, and has R^v = q, R^w = r, the first covariance p0, and other options.
    """
    robot = robot_named(name) if isinstance(name, str) else name
    given = {} if measured is None else {"measured": measured}
    law = arm_law(robot, degree, *(() if weights is None else (weights,)), pose=pose, **given)
    if kind is None:
        return fh.Controller(law, None, period, limit, **options)
    mean = robot.operating_point(pose if at is None else at)[0] if mean is None else mean
    estimator = kind(robot.plant(**given), period, q, r, mean, p0, **(filter or {}))
    return fh.Controller(law, estimator, period, limit, **options)


#: Noise of `three_sensors`, and what else a filter of them is given.
SEEN = np.array([[4e-4, 2e-4, -1e-4], [2e-4, 9e-4, 3e-4], [-1e-4, 3e-4, 2.5e-4]])
SEEN_MEAN = (0.3, 0.2, -0.1)


def seen_by_three(
    kind: Any = fh.UnscentedKalmanFilter, places: Sequence[int] = (0, 1, 2), **options: Any
) -> Any:
    """A filter of `three_sensors`, or of some of them, at 20 Hz."""
    noise = SEEN[np.ix_(places, places)]
    return kind(three_sensors(places), 0.05, 1e-5, noise, SEEN_MEAN, (0.04, 0.09, 0.01), **options)


def tracking_mass(kind: Any, **options: Any) -> fh.Controller:
    """Integral action on a measured position of a mass, with a speed sensor beside it."""
    plant = fh.Plant(
        lambda x, u, d, p: np.array([x[1], u[0] - p.damping * x[1]]),
        lambda x, u, p: np.array([x[0], x[1] + 0.1 * np.sin(x[0])]),
        ("position", "speed"), ("force",), outputs=("position", "rate"), parameters={"damping": 0.3},
    )  # fmt: skip
    penalty = fh.Penalty({"position": 3.0, "speed": 1.0, "position_integral": 2.0}, 1.0)
    law = lqr(plant.with_objective(penalty, "disturbance", ("position",)))
    noise = np.array([[1e-4, 5e-5], [5e-5, 4e-4]])
    return fh.Controller(law, kind(plant, 0.02, 1e-6, noise, (0.1, 0.0), 1e-2), 0.02, **options)


def report_numbers(*rows: tuple[str, float, bool]) -> str:
    """The design.json of a report of the paper's arm, as far as commands read it: what, found and met of requirements
    whose limit is 0."""
    lines = [Requirement(what, 0.0, found).row | {"met": met} for what, found, met in rows]
    facts = {"estimator_noise": None, "weights": {"wanted": None}}
    numbers = {"version": VERSION, "robot": "paper", "law": NL_HINF, "requirements": lines, "facts": facts}
    return json.dumps(numbers)
