"""One step of a sampled controller: estimator, integrals, law, saturation, as NumPy code.

It is what the compiled kernels run, what `Controller.step` calls and what is exported later.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.plant import Estimator, Law
from flexhinf.scalars import clip, where

__all__ = ["controller_step"]


def controller_step(
    law: Law,
    estimator: Estimator | None,
    tracked: Sequence[tuple[str, int]],
    y: Any,
    r: Any,
    memory: Any,
    data: Any,
) -> tuple[Any, Any, dict[str, Any]]:
    """One step of the controller, pure, on any element.

    Parameters
    ----------
    law, estimator : Law, Estimator or None
        Without an estimator, y is the state of the plant that the law was designed for.
    tracked : sequence of (str, int)
        "state" or "output", and the place there, of what is tracked: the measurement itself where the tracked
        state is measured, so that the integral removes the error of the measured signal, whatever the
        estimator's model gets wrong.
    y, r : (p,), (k,)
        Measurement and command.
    memory, data : namespaces
        As `Controller.memory` and `Controller.data` lay them out.

    Returns
    -------
    u, estimate, memory
        Input (m,), estimate x(k|k) (n,), and the memory for the next step.
    """
    estimate: Any = y
    belief: Any = None
    p: Any = None
    if estimator is not None:
        p = estimator.plant.parameters.named(data.parameters)
        prior = type(estimator.initial)(*memory.belief)
        belief = estimator.measurement_update(prior, y, memory.u, p, data.measurement_noise)
        estimate = np.asarray(belief.mean)

    # ė = x_i − x_d: the command is held between samples, as u is; x_i goes in by the trapezoidal rule.
    position = np.array([(y if source == "output" else estimate)[place] for source, place in tracked])
    growth = memory.started * data.period * (0.5 * (memory.position + position) - memory.reference)
    integral = memory.integral + growth

    deviation = np.concatenate([estimate, integral]) - data.operating_point
    wanted = data.operating_input + law.evaluate_law(deviation, data.law)
    u = clip(wanted, data.lower, data.upper)

    # Anti-windup: an integral that would push a saturated input further stands still.
    pushes = growth * ((wanted - u) @ data.integral_gain)
    choices = zip(pushes, memory.integral, integral)
    integral = np.array([where(push > 0.0, old, new) for push, old, new in choices])

    after = {"u": u, "integral": integral, "position": position, "reference": r, "started": np.ones(1)}
    if estimator is not None:
        after["belief"] = estimator.time_update(belief, u, p, data.process_noise)
    return u, estimate, after
