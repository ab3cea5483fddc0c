"""A plant's linearisation at an equilibrium, as a plant: what linear estimators believe in. Systems of python-control.

On it the extended Kalman filter *is* the linear Kalman filter, and a loop is one that every textbook covers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant.model import python_control
from flexhinf.plant.plant import Plant
from flexhinf.validation import real_array


@dataclass(frozen=True)
class LinearFlow:
    """ẋ = A (x − x*) + B (u − u*) + G d."""

    def __call__(self, x: Any, u: Any, d: Any, p: Any) -> Any:
        """The rates (n,) of any element."""
        rates = p.state_matrix @ (x - p.state) + p.input_matrix @ (u - p.input)
        return rates + p.disturbance_matrix @ d if np.size(p.disturbance_matrix) else rates


@dataclass(frozen=True)
class LinearOutput:
    """y = y* + C (x − x*) + D (u − u*)."""

    def __call__(self, x: Any, u: Any, p: Any) -> Any:
        """The measured signals (p,) of any element."""
        return p.output + p.output_matrix @ (x - p.state) + p.feedthrough @ (u - p.input)


def linear_plant(plant: Plant, x: Any, u: Any) -> Plant:
    """The linearisation of a plant at an equilibrium (x, u), in absolute coordinates and with the plant's own names.

    Its parameters are the matrices and the equilibrium, so that two linearisations of the same size share code.
    """
    a, b, g, c = plant.linearise(x, u)
    x, u = real_array(x), real_array(u)
    advice = "robot.operating_point(pose), or operating_point and operating_input of a problem"
    plant.check_equilibrium(x, u, "A plant is linearised at an equilibrium.", advice)
    value, slope = plant.output_at(x, u)
    parameters = {
        "state_matrix": a, "input_matrix": b, "disturbance_matrix": g, "output_matrix": c, "feedthrough": slope,
        "state": x, "input": u, "output": value,
    }  # fmt: skip
    return Plant(
        LinearFlow(), LinearOutput(), plant.states, plant.inputs, plant.disturbances, parameters,
        plant.outputs, plant.units, plant.groups,
    )  # fmt: skip


def plant_from_control(system: Any, inputs: Sequence[str] | None = None) -> Plant:
    """A linear system in continuous time of python-control (``ss`` or ``tf``) as a plant.

    Parameters
    ----------
    system : control.StateSpace or control.TransferFunction
    inputs : sequence of str, optional
        Names of the system's inputs that a controller sets; the others are disturbances. All by default.

    Raises
    ------
    InvalidInput
        If it is no linear system in continuous time, or has no such inputs.
    """
    package = python_control()
    if not isinstance(system, package.StateSpace | package.TransferFunction) or system.isdtime(strict=True):
        raise InvalidInput(
            "The system cannot become a plant.",
            "expected a linear system in continuous time, got "
            f"{type(system).__name__} with dt={getattr(system, 'dt', None)}",
            "control.ss(A, B, C, D); a nonlinear plant is a function, see flexhinf.Plant",
        )
    linear = package.ss(system)
    labels = list(linear.input_labels)
    chosen = labels if inputs is None else list(inputs)
    if not set(chosen) <= set(labels) or not chosen:
        found = f"expected some of {labels}, got {chosen}"
        raise InvalidInput("The system has no such inputs.", found, str(labels[:1]))
    places = [labels.index(name) for name in chosen]
    others = [k for k, name in enumerate(labels) if name not in chosen]
    a, b, c, d = (np.asarray(m, dtype=float) for m in (linear.A, linear.B, linear.C, linear.D))
    if d[:, others].any():
        found = f"expected D = 0 for {[labels[k] for k in others]}"
        advice = "measurement noise is the loop's; other disturbances act through a state"
        raise InvalidInput("A disturbance acts on a measurement directly.", found, advice)
    n, m = len(a), len(chosen)
    parameters = {
        "state_matrix": a, "input_matrix": b[:, places], "disturbance_matrix": b[:, others], "output_matrix": c,
        "feedthrough": d[:, places], "state": np.zeros(n), "input": np.zeros(m), "output": np.zeros(len(c)),
    }  # fmt: skip
    return Plant(
        LinearFlow(), LinearOutput(), tuple(linear.state_labels), tuple(chosen), tuple(labels[k] for k in others),
        parameters, tuple(linear.output_labels),
    )  # fmt: skip
