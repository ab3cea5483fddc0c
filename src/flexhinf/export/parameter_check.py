"""Ranges of the numbers of a controller, for ``NAME_check`` of exported C: physical ones, and those of the design.

A parameter of the model may be anywhere within the tolerances of the robot. A parameter of the plant is a function of
several numbers of the robot (a motor's inertia at the joint, of rotor and gear). Where it is monotone in each of them,
its range lies between two corners of the tolerances: those where every number moves it up, and down.

A limit may be made narrower, and a rate slower. Every other number is that of the design.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from markupsafe import Markup

from flexhinf.codegen.c import Real, constant
from flexhinf.loop import Controller
from flexhinf.plant.parameters import ParameterTable
from flexhinf.stops import Stop

if TYPE_CHECKING:
    from flexhinf.robot import Robot

#: Ranges of tolerances are wider by this part of the number, as C may round it.
ROUNDING = 1e-6


#: Limits that stand beside each other.
PAIRS = (("lower", "upper"), ("command_lower", "command_upper"), ("measurement_lower", "measurement_upper"))


class Range(NamedTuple):
    """The range of the number at `place`: it is less than that at `below` (−1: of none), physical from `least` to
    `most`, and as the design was made for from `low` to `high`."""

    place: int
    below: int
    least: float
    most: float
    low: float
    high: float


def ranges(
    controller: Controller, numbers: np.ndarray, robot: Robot | None, oldest: float, whole: Sequence[int]
) -> list[Range]:
    """Ranges of those numbers of a controller that have one, in the order of their places; the last are those of the
    oldest measurement and of the `whole` numbers: how many may be missing, what stops the robot, and the category of
    that stop."""
    rows = [*_limits(controller, numbers), *_noise(controller, numbers), *_model(controller, robot)]
    end = controller.data.size
    missing, stop_on, _ = whole
    ages = [Range(end + k, -1, 0.0, np.inf, 0.0, float(most)) for k, most in enumerate((oldest, missing))]
    stops = Range(end + 2, -1, 0.0, float(max(Stop) * 2 - 1), float(stop_on), float(stop_on))
    return [*sorted(rows), *ages, stops, Range(end + 3, -1, 0.0, 2.0, 0.0, 2.0)]


def _limits(controller: Controller, numbers: np.ndarray) -> Iterator[Range]:
    """Limits of inputs, commands and measurements, which may be narrower, and rates, which may be slower."""
    places, pairs = controller.data.places, list[tuple[int, int]]()
    for lower, upper in PAIRS:
        if lower in places:
            pairs += zip(*(range(places[name].start, places[name].stop) for name in (lower, upper)))
    if "workspace" in places:
        box = places["workspace"]
        middle = (box.start + box.stop) // 2
        pairs += zip(range(box.start, middle), range(middle, box.stop))
    for low, high in pairs:
        yield Range(low, high, -np.inf, np.inf, numbers[low], np.inf)
        yield Range(high, -1, -np.inf, np.inf, -np.inf, numbers[high])
    for name in {"input_rate", "command_rate", "measurement_rate"} & set(places):
        for place in range(places[name].start, places[name].stop):
            yield Range(place, -1, 0.0, np.inf, 0.0, numbers[place])


def _noise(controller: Controller, numbers: np.ndarray) -> Iterator[Range]:
    """Variances, which are not negative; the design's own are the only ones that were tested."""
    for name in ("process_noise", "measurement_noise"):
        if name in controller.data.places:
            place = controller.data.places[name]
            rows = math.isqrt(place.stop - place.start)
            for k in range(place.start, place.stop, rows + 1):
                variance = float(numbers[k])
                yield Range(k, -1, 0.0, np.inf, variance, variance)


def _model(controller: Controller, robot: Robot | None) -> Iterator[Range]:
    """Parameters of the estimator's model that are those of the robot."""
    if controller.estimator is None or robot is None:
        return
    table = ParameterTable(robot.plant_parameters())
    low, high = map(table.named, corners(robot))
    place = controller.data.places["parameters"].start
    for name, value in controller.estimator.plant.parameters.values.items():
        if name in table.values and table.values[name].shape == value.shape:
            pairs = np.transpose([np.ravel(getattr(low, name)), np.ravel(getattr(high, name))])
            for k, ends in enumerate(pairs):
                spare = ROUNDING * float(np.abs(ends).max())
                yield Range(
                    place + k, -1, _physical_minimum(name, k), np.inf, ends[0] - spare, ends[1] + spare
                )
        place += value.size


def _physical_minimum(name: str, k: int) -> float:
    """The least physical value of element k of a parameter; a positive one that is tiny is refused as zero is."""
    from flexhinf.robot.parameters import INERTIA, QUANTITIES

    if name == "inertia":
        return 0.0 if INERTIA[k % len(INERTIA)] in ("xx", "yy", "zz") else -np.inf
    sign = QUANTITIES[name].sign if name in QUANTITIES else "any"
    return {"positive": float(np.finfo(np.float32).tiny), "not negative": 0.0, "any": -np.inf}[sign]


def corners(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest values of the parameters of a robot's plant within the tolerances, flat.

    Each number of the robot is moved alone to see which way it moves every parameter; then all of them at once.
    """

    def at(signs: dict[str, float]) -> np.ndarray:
        return ParameterTable(robot.corner(signs)).vector()

    names = [parameter.name for parameter in robot.uncertain]
    low, high = at({}), at({})
    moved = [np.sign(at({name: 1.0}) - at({name: -1.0})) for name in names]
    signs = np.reshape(moved, (len(names), low.size)).T
    for pattern in np.unique(signs, axis=0):
        same = (signs == pattern).all(axis=1)
        for ends, side in ((low, -1.0), (high, 1.0)):
            ends[same] = at(dict(zip(names, (side * pattern).tolist(), strict=True)))[same]
    return low, high


def range_rows(rows: list[Range], real: Real) -> Markup:
    """The ranges as constants of C."""

    def ends(low: float, high: float) -> str:
        anything = low == -np.inf and high == np.inf
        return "ANY" if anything else f"{constant(float(low), real)}, {constant(float(high), real)}"

    lines = (
        f"    {{{row.place}, {row.below}, {ends(row.least, row.most)}, {ends(row.low, row.high)}}}"
        for row in rows
    )
    return Markup(",\n".join(lines))
