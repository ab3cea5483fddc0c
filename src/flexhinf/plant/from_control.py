"""Systems of python-control as plants."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant.linear import LinearFlow, LinearOutput
from flexhinf.plant.plant import Plant
from flexhinf.plant.to_control import python_control


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
        raise InvalidInput(
            "The system has no such inputs.", f"expected some of {labels}, got {chosen}", str(labels[:1])
        )
    places = [labels.index(name) for name in chosen]
    others = [k for k, name in enumerate(labels) if name not in chosen]
    a, b, c, d = (np.asarray(m, dtype=float) for m in (linear.A, linear.B, linear.C, linear.D))
    if d[:, others].any():
        raise InvalidInput(
            "A disturbance acts on a measurement directly.", f"expected D = 0 for {[labels[k] for k in others]}",
            "measurement noise is the loop's; other disturbances act through a state",
        )  # fmt: skip
    n, m = len(a), len(chosen)
    parameters = {
        "state_matrix": a, "input_matrix": b[:, places], "disturbance_matrix": b[:, others], "output_matrix": c,
        "feedthrough": d[:, places], "state": np.zeros(n), "input": np.zeros(m), "output": np.zeros(len(c)),
    }  # fmt: skip
    return Plant(
        LinearFlow(), LinearOutput(), tuple(linear.state_labels), tuple(chosen), tuple(labels[k] for k in others),
        parameters, tuple(linear.output_labels),
    )  # fmt: skip
