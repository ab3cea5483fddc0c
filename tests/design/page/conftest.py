"""Designs whose pages are read: made once for all tests."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from flexhinf.design import Design, Specification, design


@pytest.fixture(scope="session")
def page_design(robot_of: Callable[[str], Any]) -> Callable[[str], Design]:
    """By what is special about it."""
    half_turn = {"pose": [math.pi / 2], "start": [0.0], "draws": 16, "rays": 50, "degrees": (2, 4)}
    asked: dict[str, tuple[str, dict[str, Any]]] = {
        "met": ("paper", {**half_turn, "bandwidth": 4.0, "damping": 0.3, "peak_effort": 60.0}),
        "rings": ("paper", {"preset": "paper", "rays": 0, "degrees": (2,), "draws": 3, "duration": 4.0}),
        "robust": ("paper", {"preset": "robust", "rays": 0, "degrees": (2,), "draws": 2, "compare_rigid": False}),
        "cart": (
            "cart",
            {
                "measured": ("motor_position", "joint_torque"), "estimator": "ekf", "saturation": 300.0,
                "degrees": (2,), "rays": 0, "draws": 4, "bandwidth": 3.0,
            },
        ),
        "true state": (
            "quanser-rotflex",
            {"estimator": "none", "degrees": (2,), "rays": 20, "draws": 0, "compare_rigid": False},
        ),
    }  # fmt: skip
    made: dict[str, Design] = {}

    def of(name: str) -> Design:
        if name not in made:
            robot, options = asked[name]
            made[name] = design(robot_of(robot), Specification(**options))
        return made[name]

    return of
