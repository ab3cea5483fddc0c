"""When a law takes over, the input continues from the last one: bumpless transfer.

The integrals are what a law remembers, so they are chosen to make it ask for the input that acts already:
u* + k(x − x*, e) = u_last, by a fixed number of Broyden's steps [broyden1965] from the integrals as they are and
the inverse slope at the operating point. What no integral reaches (a law without integrals, fewer integrals than
inputs, a polynomial without such a root) is held as a bias that fades, so that the input is continuous always.
Every step is one evaluation of the law, so that it may be a polynomial of any degree; composed kernels make them
only when a law takes over.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.options import Mode, positive
from flexhinf.scalars import absolute, where
from flexhinf.untrusted import value_text

#: Time constant of the bias that fades, s.
FADE = 0.5

#: Broyden's steps. One integral needs about five to a relative 1e-12, far from the operating point too.
STEPS = 10

#: Directions of the integrals whose slope is below this fraction of the largest one are not used.
FLAT = 1e-9

#: Below this fraction of the size of its terms, the divisor of Broyden's update is rounding.
ROUNDING = 1e-14


def fade_time(fade: Any, mode: Mode) -> float:
    """The time constant of the bias, s.

    Raises
    ------
    InvalidInput
        If it is not positive, or given though no law ever takes over.
    """
    if fade is not None and not mode.takes_over:
        raise InvalidInput(
            "A time constant is given for a bias that never is.",
            f"expected fade=None for one law that starts from zero, got {value_text(fade)}",
            "start='bumpless', or a Schedule of several laws",
        )
    return FADE if fade is None else positive(fade, "time constant of the fading bias", "fade=0.5")


def inverse_slope(slope: np.ndarray) -> np.ndarray:
    """Least-squares inverse (k, m) of ∂u/∂e (m, k) at the operating point."""
    return np.linalg.pinv(slope, rcond=FLAT)


def continued(
    run: Any,
    law: Callable[[Any], Any],
    taken: Any,
    deviation: Any,
    feedback: Any,
    wanted: Any,
    inverse: Any,
    growth: Any,
    bias: Any,
    point: Any,
    decay: Any,
) -> tuple[Any, Any, Any, Any]:
    """The feedback of a sample at which a law may take over.

    Parameters
    ----------
    law : callable
        k(x) on the run, (m,).
    taken : (1,)
        1 where a law takes over at this sample, else 0.
    deviation, feedback : (n + k,), (m,)
        The law's argument with the integrals as they are, and k of it.
    wanted : (m,)
        u_last − u*.
    inverse : (k, m)
        See `inverse_slope`.
    growth : (k,)
        Of the integrals since the last sample.
    bias : (m,)
        Of the last sample.
    point, decay : (n + k,), (1,)
        x*, and the fraction of the bias that is left after a period.

    Returns
    -------
    feedback, growth, integral, bias
        k with the bias (m,); growth and integrals (k,), the growth zero where a law takes over; the bias (m,).
    """
    n = deviation.shape[0] - growth.shape[0]
    misfit, errors = wanted, deviation[n:]
    with run.when(taken):
        misfit = run.call(_minus, wanted, feedback)

        def step(errors: Any, misfit: Any, inverse: Any) -> tuple[Any, Any, Any]:
            trial = run.call(_trial, deviation[:n], errors, inverse, misfit)
            return run.call(_kept, errors, misfit, inverse, trial, law(trial), wanted)

        if growth.shape[0]:
            errors, misfit, _ = run.repeat(STEPS, step, errors, misfit, inverse)
    parts = (taken, feedback, wanted, misfit, errors, growth, bias, deviation, point, decay)
    return run.call(partial(_joined, n), *parts)


def _minus(wanted: Any, feedback: Any) -> Any:
    return wanted - feedback


def _trial(states: Any, errors: Any, inverse: Any, misfit: Any) -> Any:
    """The law's argument one step on."""
    return np.concatenate([states, errors + inverse @ misfit])


def _kept(
    errors: Any, misfit: Any, inverse: Any, trial: Any, value: Any, wanted: Any
) -> tuple[Any, Any, Any]:
    """The better of two, and the inverse slope that explains what the step did (Broyden's good update)."""
    step, rest = trial[trial.shape[0] - errors.shape[0] :] - errors, wanted - value
    did = inverse @ (misfit - rest)
    divisor, size = step @ did, absolute(step) @ absolute(did)
    usable = absolute(divisor) > ROUNDING * size
    share = where(usable, 1.0 / where(usable, divisor, 1.0), 0.0)
    better = rest @ rest < misfit @ misfit
    inverse = inverse + np.outer((step - did) * share, step @ inverse)
    return where(better, errors + step, errors), where(better, rest, misfit), inverse


def _joined(
    n: int,
    taken: Any,
    feedback: Any,
    wanted: Any,
    misfit: Any,
    errors: Any,
    growth: Any,
    bias: Any,
    deviation: Any,
    point: Any,
    decay: Any,
) -> tuple[Any, Any, Any, Any]:
    """What was found where a law takes over, else what was; see `continued`."""
    new = taken[0] > 0.5
    integral = where(new, errors, deviation[n:]) + point[n:]
    bias = where(new, misfit, decay * bias)
    feedback = where(new, wanted, feedback + bias)
    return feedback, where(new, 0.0, growth), integral, bias
