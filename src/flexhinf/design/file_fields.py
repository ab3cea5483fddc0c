"""What the table [design] of a design file may hold: the fields of a specification, each with its kind."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

__all__ = ["FIELDS", "Kind"]


@dataclass(frozen=True)
class Kind:
    """What a value must be.

    Attributes
    ----------
    words : str
        What is allowed.
    example : str
    read : callable
        From what TOML gives to what a specification holds; raises ValueError for another kind.
    """

    words: str
    example: str
    read: Callable[[Any], Any]


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ValueError
    return float(value)


def _integer(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError
    return value


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError
    return value


def _list(of: Callable[[Any], Any], least: int = 1) -> Callable[[Any], tuple]:
    def read(value: Any) -> tuple:
        if not isinstance(value, list) or len(value) < least:
            raise ValueError
        return tuple(of(one) for one in value)

    return read


def _number_or_list(value: Any) -> Any:
    return _list(_number)(value) if isinstance(value, list) else _number(value)


def _weights(value: Any) -> Any:
    if isinstance(value, dict):
        if not value:
            raise ValueError
        return {name: _number_or_list(weight) for name, weight in value.items()}
    if isinstance(value, list) and value and isinstance(value[0], list):
        rows = _list(_list(_number))(value)
        if len({len(row) for row in rows}) > 1:
            raise ValueError
        return rows
    return _list(_number)(value)


_POSE = "a list of numbers, one link position per joint (rad, m), or one number"
_WEIGHTS = "a table of weights by name, or a list of one per state, or of rows"


def _a_number(example: str) -> Kind:
    return Kind("a number", example, _number)


def _an_integer(example: str) -> Kind:
    return Kind("an integer", example, _integer)


FIELDS = {
    "pose": Kind(_POSE, "pose = [0.3, -0.5]", _number_or_list),
    "start": Kind(_POSE, "start = [0.2, -0.4]", _number_or_list),
    "via": Kind("a list of poses", "via = [[0.1, 0.2], [0.3, 0.4]]", _list(_list(_number), 0)),
    "preset": Kind("text", 'preset = "damped"', _text),
    "bandwidth": Kind("rad/s: a number, or a list of one per joint", "bandwidth = 4.0", _number_or_list),
    "damping": _a_number("damping = 0.3"),
    "peak_effort": _a_number("peak_effort = 60.0"),
    "overshoot": _a_number("overshoot = 5.0"),
    "penalty": Kind(_WEIGHTS, "[design.penalty], below it link_position = 60.0", _weights),
    "effort": _a_number("effort = 10.0"),
    "gamma_ratio": _a_number("gamma_ratio = 1.5"),
    "checked_gamma_ratio": _a_number("checked_gamma_ratio = 1.6"),
    "checked_penalty": Kind(_WEIGHTS, "[design.checked_penalty], below it link_position = 54.0", _weights),
    "degrees": Kind("a list of integers", "degrees = [2, 4]", _list(_integer)),
    "measured": Kind("a list of names", 'measured = ["motor_position"]', _list(_text)),
    "disturbances": Kind("a list of names", 'disturbances = ["link_torque"]', _list(_text)),
    "command": Kind("true or false", "command = true", _flag),
    "estimator": Kind("text", 'estimator = "ukf"', _text),
    "period": _a_number("period = 1e-3"),
    "process_noise": _a_number("process_noise = 1e-10"),
    "torque_noise": _a_number("torque_noise = 1e-7"),
    "measurement_noise": _a_number("measurement_noise = 1e-8"),
    "saturation": _a_number("saturation = 24.0"),
    "extras": Kind("a list of names", 'extras = ["coulomb_friction"]', _list(_text, 0)),
    "delay": _a_number("delay = 1e-3"),
    "quantisation": _a_number("quantisation = 1e-4"),
    "load": _a_number("load = 1.0"),
    "draws": _an_integer("draws = 200"),
    "rays": _an_integer("rays = 1000"),
    "duration": _a_number("duration = 5.0"),
    "seed": _an_integer("seed = 0"),
    "compare_rigid": Kind("true or false", "compare_rigid = false", _flag),
    "mujoco": Kind("true or false", "mujoco = true", _flag),
}
