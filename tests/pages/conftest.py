"""Designs and a comparison whose reports are read: made once, with few tolerances, so that they are fast."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from flexhinf.design import Comparison, Design, Specification, compare, design, tuning


@pytest.fixture(scope="session")
def report_design(
    robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any]
) -> Callable[[str], Design]:
    """By what is special about it."""
    half_turn = {"pose": "90deg", "start": "0", "draws": 16, "degrees": (2, 4), "compare_rigid": True}
    noise = {"torque_noise": 1e-5}
    cases: dict[str, tuple[str, tuple[str, ...], dict[str, Any]]] = {
        "met": (
            "paper", ("stiffness", "friction"),
            {**half_turn, "rays": 50, "bandwidth": 3.0, "damping": 0.2, "peak_effort": 60.0},
        ),
        "rings": (
            "paper", ("stiffness", "friction", "mass"),
            {**noise, "preset": "paper", "rays": 0, "degrees": (2,), "draws": 3, "duration": 4.0},
        ),
        "robust": (
            "paper", ("stiffness", "friction"),
            {**noise, "preset": "robust", "rays": 0, "degrees": (2,), "draws": 2, "compare_rigid": False},
        ),
        "cart": (
            "cart", ("stiffness_belt", "stiffness_arm"),
            {
                **noise, "measured": ("motor_position", "joint_torque"), "estimator": "ekf", "saturation": 300.0,
                "degrees": (2,), "rays": 0, "draws": 4, "bandwidth": 3.0,
            },
        ),
        "true state": (
            "quanser-rotflex", (),
            {"estimator": "none", "degrees": (2,), "rays": 20, "draws": 0, "compare_rigid": False},
        ),
    }  # fmt: skip
    made: dict[str, Design] = {}

    def of(name: str) -> Design:
        if name not in made:
            robot, uncertain, options = cases[name]
            made[name] = design(only_uncertain(robot_of(robot), *uncertain), Specification(**options))
        return made[name]

    return of


@pytest.fixture(scope="session")
def report_comparison(robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any]) -> Comparison:
    """The design's own law, LQR and two PD laws, a step of 0.3 rad."""
    robot = only_uncertain(robot_of("paper"), "stiffness", "friction")
    s = Specification(
        pose=[math.pi / 2], start=[math.pi / 2 - 0.3], preset="damped", bandwidth=3.0, damping=0.2,
        torque_noise=1e-5, degrees=(2,), rays=0, draws=2, duration=3.0,
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:  # how laws are tuned is tested elsewhere
        patch.setattr(tuning, "BUDGET", ((10_000, 0, 0),))
        return compare(robot, s, ["hinf", "lqr", "pd", "pid"])
