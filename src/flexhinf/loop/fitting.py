"""Whether a law, an estimator and a period fit each other: refused before any work is lost."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant import Estimator, Law

__all__ = ["INTEGRAL", "check_kinds", "check_names"]

#: What the name of an integral of an error ends with.
INTEGRAL = "_integral"


def check_kinds(law: Any, estimator: Any) -> None:
    """They are a law with finite numbers of the right sizes, and an estimator or None."""
    if not isinstance(law, Law):
        raise InvalidInput(
            "The controller needs a law.",
            f"expected state_names, evaluate_law and so on, got {type(law).__name__}",
            "a solution of solve_hji or linear_law",
        )
    if estimator is not None and not isinstance(estimator, Estimator):
        raise InvalidInput(
            "The controller's estimator is none.",
            f"expected UnscentedKalmanFilter, ExtendedKalmanFilter or None, got {type(estimator).__name__}",
            "Controller(solution, estimator, period)",
        )
    n, m = len(law.state_names), len(law.input_names)
    point, rest = np.asarray(law.operating_point), np.asarray(law.operating_input)
    if point.shape != (n,) or rest.shape != (m,) or not np.all(np.isfinite(np.ravel(law.law_data))):
        raise InvalidInput(
            "The law's numbers do not fit its names, or are not finite.",
            f"expected an operating point ({n},) and input ({m},), got {point.shape} and {rest.shape}",
            "one value per name",
        )


def check_names(
    law: Law, estimator: Estimator | None, period: float, states: tuple[str, ...], tracked: tuple[str, ...]
) -> None:
    """The law's states are the plant's, then integrals; the estimator means the same, at the same period."""
    order = (*states, *(name + INTEGRAL for name in tracked))
    if order != tuple(law.state_names) or not set(tracked) <= set(states):
        raise InvalidInput(
            "The law's states are not the plant's states followed by integrals of some of them.",
            f"got {list(law.state_names)}",
            "name the integral of the error of NAME 'NAME_integral', last",
        )
    if estimator is None:
        return
    plant = estimator.plant
    model = (tuple(plant.states), tuple(plant.inputs))
    if model != (states, tuple(law.input_names)):
        raise InvalidInput(
            "The estimator and the law do not mean the same states and inputs.",
            f"the law needs {list(states)} and {list(law.input_names)}, "
            f"the estimator's plant has {list(plant.states)} and {list(plant.inputs)}",
            "the same plant for both",
        )
    if abs(estimator.period - period) > 1e-12 * period:
        raise InvalidInput(
            "The estimator and the controller run at different periods.",
            f"expected {period} s, got {estimator.period} s",
            "the same period for both",
        )
