"""A bumpless transfer from one law to another.

The input continues from the last one. The integrals are the memory of a law, so they are chosen such that its
output is the input that acts already: u* + k(x − x*, e) = u_last, by a fixed number of Broyden's steps [broyden1965]
from the integrals as they are and the inverse slope at the operating point. The part that no integral can supply (a law
without integrals, fewer integrals than inputs, a polynomial without such a root) is held as a bias that decays, so that
the input is continuous always. Every step is one evaluation of the law, so that it may be a polynomial of any degree;
composed kernels make them only when a law takes over.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from flexhinf.codegen import gives
from flexhinf.scalars import absolute, where

#: Broyden's steps. One integral needs about five to a relative 1e-12, far from the operating point too.
STEPS = 10

#: Directions of the integrals whose slope is below this fraction of the largest one are not used.
FLAT = 1e-9

#: Below this fraction of the size of its terms, the divisor of Broyden's update is rounding.
ROUNDING = 1e-14


def inverse_slope(slope: np.ndarray) -> np.ndarray:
    """Least-squares inverse (k, m) of ∂u/∂e (m, k) at the operating point."""
    return np.linalg.pinv(slope, rcond=FLAT)


def bumpless_transfer(
    run: Any,
    law: Callable[[Any], Any],
    taken: Any,
    deviation: Any,
    feedback: Any,
    wanted: Any,
    inverse: Any,
    bias: Any,
    point: Any,
    decay: Any,
) -> tuple[Any, Any, Any]:
    """The feedback of a sample at which a law may take over.

    Arguments: the law k(x) on the run; `taken` (1,), 1 where a law takes over at this sample, else 0; the law's
    argument (n + k,) with the integrals as they are and k of it; u_last − u* (m,); the inverse slope (k, m), see
    `inverse_slope`; the last bias (m,); x* (n + k,); and the fraction of the bias that is left after a period (1,).

    Returns k with the bias (m,), the integrals (k,), and the bias (m,).
    """
    integrals = inverse.shape[0]
    n = deviation.shape[0] - integrals
    misfit, errors = wanted, deviation[n:]

    def trial(states: Any, errors: Any, inverse: Any, misfit: Any) -> Any:
        """The law's argument with integrals that are one step of Broyden's method further."""
        return np.concatenate([states, errors + inverse @ misfit])

    with run.when(taken):
        misfit = run.call(_misfit, wanted, feedback)

        def broyden(errors: Any, misfit: Any, inverse: Any) -> tuple[Any, Any, Any]:
            tried = run.call(trial, deviation[:n], errors, inverse, misfit)
            return run.call(_better, errors, misfit, inverse, tried, law(tried), wanted)

        if integrals:
            errors, misfit, _ = run.repeat(STEPS, broyden, errors, misfit, inverse)
    return run.call(
        partial(_joined, n), taken, feedback, wanted, misfit, errors, bias, deviation, point, decay
    )


@gives("wanted")
def wanted_feedback(last: Any, operating: Any) -> Any:
    """What the law must give for the last input to go on."""
    return last - operating


@gives("first_misfit")
def _misfit(wanted: Any, feedback: Any) -> Any:
    return wanted - feedback


@gives("errors", "misfit", "inverse")
def _better(
    errors: Any, misfit: Any, inverse: Any, trial: Any, value: Any, wanted: Any
) -> tuple[Any, Any, Any]:
    """Integrals, misfit and inverse slope after a step of Broyden's method, where the step made the misfit smaller."""
    step, left = trial[trial.shape[0] - errors.shape[0] :] - errors, wanted - value
    did = inverse @ (misfit - left)
    divisor, size = step @ did, absolute(step) @ absolute(did)
    usable = absolute(divisor) > ROUNDING * size
    share = where(usable, 1.0 / where(usable, divisor, 1.0), 0.0)
    better = left @ left < misfit @ misfit
    inverse = inverse + np.outer((step - did) * share, step @ inverse)  # Broyden's good update
    return where(better, errors + step, errors), where(better, left, misfit), inverse


@gives("feedback_now", "integral_now", "bias")
def _joined(
    n: int,
    taken: Any,
    feedback: Any,
    wanted: Any,
    misfit: Any,
    errors: Any,
    bias: Any,
    deviation: Any,
    point: Any,
    decay: Any,
) -> tuple[Any, Any, Any]:
    new = taken[0] > 0.5
    integral = where(new, errors, deviation[n:]) + point[n:]
    bias = where(new, misfit, decay * bias)
    feedback = where(new, wanted, feedback + bias)
    return feedback, integral, bias
