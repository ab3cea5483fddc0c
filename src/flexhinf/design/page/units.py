"""Units and positions in words: radians and degrees for what turns, metres for what slides."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from flexhinf.design.result import Design
from flexhinf.report import number
from flexhinf.robot.signals import signal_names

__all__ = ["Units", "pose_words", "step_words", "units_of"]


class Units:
    """Of the signals of a design; with joints of both kinds "rad or m".

    Attributes
    ----------
    position, load, spring, effort : str
        Of link positions, torques on links, torques of springs, inputs.
    """

    def __init__(self, design: Design) -> None:
        plant, joints = design.problem.plant, design.robot.joint_names

        def of(signal: str) -> str:
            return _joined(plant.unit(name) for name in signal_names(signal, joints))

        self.position, self.load, self.spring = of("link_position"), of("link_torque"), of("joint_torque")
        self.effort = _joined(plant.unit(name) for name in plant.inputs)

    @property
    def speed(self) -> str:
        """Of link velocities."""
        return " or ".join(f"{unit}/s" for unit in self.position.split(" or "))


def units_of(design: Design) -> Units:
    """Of the signals of a design."""
    return Units(design)


def _joined(units: Iterable[str]) -> str:
    return " or ".join(dict.fromkeys(units))


def pose_words(values: Sequence[float] | np.ndarray, slides: Sequence[bool]) -> str:
    """A pose as (0.6 rad = 34.4°, 0.1 m); many joints without degrees."""
    words = []
    for value, sliding in zip(values, slides):
        text = number(float(value) + 0.0)
        if len(slides) <= 3 and not sliding:
            degrees = number(math.degrees(value) + 0.0, 3)
            text = f"{text} rad = {degrees}°" if value else "0"
        words.append(f"{text} m" if sliding else text)
    return ", ".join(words) if len(words) == 1 else f"({', '.join(words)})"


def step_words(amplitude: float, unit: str) -> str:
    """A rest-to-rest step."""
    if math.isnan(amplitude):
        return "–"
    if math.isinf(amplitude):
        return "any looked at"
    degrees = f" ({math.degrees(amplitude):.3g}°)" if unit == "rad" else ""
    return f"{amplitude:.3g} {unit}{degrees}"
