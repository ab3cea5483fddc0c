"""Robust nonlinear H∞ control of robots with elastic joints.

``import flexhinf as fh`` is quick: every public name is loaded when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_PUBLIC = {
    "robot": ("Parameter", "Robot", "catalogue", "load_robot", "paper_arm"),
    "plant": ("GeneralisedPlant", "Penalty", "Plant", "PolynomialPlant"),
    "hinf": ("HJISolution", "linear_law", "load_solution", "smallest_gamma", "solve_hji"),
    "estimation": ("ExtendedKalmanFilter", "OutputInjectionObserver", "UnscentedKalmanFilter"),
    "loop": (
        "Constant",
        "Controller",
        "JerkLimited",
        "Loop",
        "Moving",
        "Quintic",
        "Samples",
        "Schedule",
        "Sine",
        "Spline",
        "Step",
        "Trajectory",
    ),
    "design": ("Comparison", "Design", "Specification", "compare", "load_design"),
    "errors": ("FlexhinfError", "InfeasibleGamma", "InvalidInput", "NumericalFailure"),
}
_ROOM_OF = {name: room for room, names in _PUBLIC.items() for name in names}

__all__ = [  # noqa: RUF022 (grouped by room, as above)
    "Parameter", "Robot", "catalogue", "load_robot", "paper_arm",
    "GeneralisedPlant", "Penalty", "Plant", "PolynomialPlant",
    "HJISolution", "linear_law", "load_solution", "smallest_gamma", "solve_hji",
    "ExtendedKalmanFilter", "OutputInjectionObserver", "UnscentedKalmanFilter",
    "Constant", "Controller", "JerkLimited", "Loop", "Moving", "Quintic",
    "Samples", "Schedule", "Sine", "Spline", "Step", "Trajectory",
    "Comparison", "Design", "Specification", "compare", "design", "load_design",
    "FlexhinfError", "InfeasibleGamma", "InvalidInput", "NumericalFailure",
]  # fmt: skip

if TYPE_CHECKING:
    from flexhinf.design import Comparison, Design, Specification, compare, design, load_design
    from flexhinf.errors import FlexhinfError, InfeasibleGamma, InvalidInput, NumericalFailure
    from flexhinf.estimation import ExtendedKalmanFilter, OutputInjectionObserver, UnscentedKalmanFilter
    from flexhinf.hinf import HJISolution, linear_law, load_solution, smallest_gamma, solve_hji
    from flexhinf.loop import (
        Constant,
        Controller,
        JerkLimited,
        Loop,
        Moving,
        Quintic,
        Samples,
        Schedule,
        Sine,
        Spline,
        Step,
        Trajectory,
    )
    from flexhinf.plant import GeneralisedPlant, Penalty, Plant, PolynomialPlant
    from flexhinf.robot import Parameter, Robot, catalogue, load_robot, paper_arm


def __getattr__(name: str) -> Any:
    if name in _ROOM_OF:
        value = getattr(import_module(f"flexhinf.{_ROOM_OF[name]}"), name)
        globals()[name] = value
        return value
    if name == "design":  # the room is called as its function, whichever of its files was imported before
        return import_module("flexhinf.design")
    raise AttributeError(f"module 'flexhinf' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
