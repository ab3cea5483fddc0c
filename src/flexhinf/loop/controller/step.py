"""One step of a sampled controller: estimator, integrals, law, saturation, as NumPy code.

It is what the compiled kernels run, what `Controller.step` calls and what is exported later. How its functions
are called is left to a *run*: directly on arrays, or as pieces of a program (`flexhinf.codegen.compose`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from flexhinf.codegen import DIRECT
from flexhinf.loop.controller.law_code import LawCode
from flexhinf.loop.controller.options import Mode, Source
from flexhinf.loop.controller.schedule import chosen
from flexhinf.loop.controller.transfer import continued
from flexhinf.plant import Estimator
from flexhinf.scalars import absolute, clip, where

STANDING = Mode()


def controller_step(
    law: LawCode,
    estimator: Estimator | None,
    tracked: Sequence[Source],
    y: Any,
    r: Any,
    memory: Any,
    data: Any,
    run: Any = DIRECT,
    mode: Mode = STANDING,
) -> tuple[Any, Any, dict[str, Any]]:
    """One step of the controller, pure, on any element.

    Parameters
    ----------
    law, estimator : LawCode, Estimator or None
        Without an estimator, y is the state of the plant that the law was designed for.
    tracked : sequence of Source
        Where each tracked state is read.
    y, r : (p,) or None, (k,)
        Measurement and command; a moving reference is r = (x_d, u_d), (n + m,). Without a measurement the prediction
        stands for the estimate and for what is measured.
    memory, data : namespaces
        As `Controller.memory` and `Controller.data` lay them out.

    Returns
    -------
    u, estimate, memory
        Input (m,), estimate x(k|k) (n,), and the memory for the next step.
    """
    estimate: Any = y
    belief: Any = None
    if estimator is not None:
        prior = type(estimator.initial)(*memory.belief)
        belief = prior
        if y is not None:
            belief = estimator.measurement_update_on(
                run, prior, y, memory.u, data.parameters, data.measurement_noise
            )
        estimate = belief.mean
        if y is None:
            y, tracked = estimate, [Source(False, source.state, source.state) for source in tracked]
    requested, held = r, memory.reference
    if mode.limits_command:
        held = memory.command
        r = run.call(
            partial(_limited, tracked), y, estimate, r, held, memory.started, data.period, data.command_lower,
            data.command_upper, data.command_rate,
        )  # fmt: skip
    active: Any = None
    taken: Any = None
    point, rest, gain = data.operating_point, data.operating_input, data.integral_gain
    inverse = data.inverse_slope if mode.takes_over else None
    lines = [data.windup_line, data.windup_spread] if mode.bounds_windup else []
    if mode.laws > 1:
        places = [source.state for source in tracked]
        active, taken, point, rest, gain, inverse, *lines = chosen(
            run, places, mode, r, memory.active, memory.started, data
        )
    elif mode.takes_over:
        taken = run.call(_first, memory.started)
    rest = r[len(estimate) :] if mode.moving else rest
    text, moving = (_error_coordinates, (r,)) if mode.moving else (_deviation, ())
    zone = (data.integral_dead_zone,) if mode.has_dead_zone else ()
    position, growth, integral, deviation = run.call(
        partial(text, tracked), y, estimate, memory.position, held, memory.integral,
        memory.started, data.period, point, *moving, *zone,
    )  # fmt: skip
    about = run.call(partial(_split, len(estimate)), r) if mode.moving and law.placed else None
    law_of = law.on(run, data.law, active, about)
    feedback = law_of(deviation)
    after = {"position": position, "reference": requested, "command": r, "active": active}
    if mode.takes_over:
        wanted = run.call(_difference, memory.u, rest)
        feedback, growth, integral, after["bias"] = continued(
            run, law_of, taken, deviation, feedback, wanted, inverse, growth, memory.bias, point, data.decay
        )
    rates = (memory.u, data.period, data.input_rate) if mode.limits_input_rate else ()
    bounds = ()
    if mode.bounds_windup:
        places = None if mode.moving else [source.state for source in tracked]
        bounds = (run.call(partial(_wound, places), integral, point, gain, r, *lines, data.windup_limit),)
    after["u"], after["integral"], after["started"] = run.call(
        partial(_input, mode.bounds_windup), feedback, growth, integral, memory.integral, rest, data.lower, data.upper,
        gain, *bounds, *rates,
    )  # fmt: skip
    u = after["u"]
    if estimator is not None:
        after["belief"] = estimator.time_update_on(run, belief, u, data.parameters, data.process_noise)
    return u, estimate, after


def _split(states: int, r: Any) -> tuple[Any, Any]:
    """State and input of a moving reference, in memory of their own: loops inside a sample may read them."""
    return r[:states], r[states:]


def _first(started: Any) -> Any:
    """1 at the first sample, else 0."""
    return 1.0 - started


def _difference(one: Any, other: Any) -> Any:
    return one - other


def _deviation(
    tracked: Sequence[Source],
    y: Any,
    estimate: Any,
    last: Any,
    reference: Any,
    integral: Any,
    started: Any,
    period: Any,
    point: Any,
    *zone: Any,
) -> tuple[Any, Any, Any, Any]:
    """Tracked positions, growth of the integrals, integrals, and the law's argument x − x*."""
    # ė = x_i − x_d: the command is held between samples, as u is; x_i goes in by the trapezoidal rule.
    position = _positions(tracked, y, estimate)
    growth = started * period * _beyond(0.5 * (last + position) - reference, *zone)
    integral = integral + growth
    return position, growth, integral, np.concatenate([np.asarray(estimate), integral]) - point


def _error_coordinates(
    tracked: Sequence[Source],
    y: Any,
    estimate: Any,
    last: Any,
    reference: Any,
    integral: Any,
    started: Any,
    period: Any,
    point: Any,
    moving: Any,
    *zone: Any,
) -> tuple[Any, Any, Any, Any]:
    """As `_deviation`, with the law's argument x − x_d about the moving reference of this sample."""
    # ė = x_i − x_di, both of which move between samples: the error goes in by the trapezoidal rule.
    n, places = len(estimate), [source.state for source in tracked]
    position = _positions(tracked, y, estimate)
    growth = (
        started * period * _beyond(0.5 * ((last - reference[places]) + (position - moving[places])), *zone)
    )
    integral = integral + growth
    deviation = np.concatenate([np.asarray(estimate) - moving[:n], integral - point[n:]])
    return position, growth, integral, deviation


def _beyond(error: Any, *zone: Any) -> Any:
    """What of an error (k,) lies beyond the dead zone ±zone (k,); all of it without one."""
    return error if not zone else error - clip(error, -zone[0], zone[0])


def _positions(tracked: Sequence[Source], y: Any, estimate: Any) -> np.ndarray:
    """The tracked states, (k,)."""
    return np.array([(y if source.measured else estimate)[source.place] for source in tracked])


def _limited(
    tracked: Sequence[Source],
    y: Any,
    estimate: Any,
    r: Any,
    last: Any,
    started: Any,
    period: Any,
    lower: Any,
    upper: Any,
    rate: Any,
) -> Any:
    """The command (k,) within its range, and as near to the last one, at first the positions, as its rate says."""
    last = where(started[0] > 0.5, last, _positions(tracked, y, estimate))
    return clip(clip(r, lower, upper), last - period * rate, last + period * rate)


def _wound(
    places: Sequence[int] | None,
    integral: Any,
    point: Any,
    gain: Any,
    r: Any,
    line: Any,
    spread: Any,
    limit: Any,
) -> Any:
    """What integrals push (m,) beyond their bound, see `flexhinf.loop.controller.windup`; about a moving reference,
    which has no `places`, the law needs none of it at rest."""
    pushed = gain @ (integral - point[len(point) - len(integral) :])
    if places is not None:
        away = r - point[places]
        pushed, limit = pushed - line @ away, limit + spread @ absolute(away)
    return pushed - clip(pushed, -limit, limit)


def _input(
    bounded: bool,
    feedback: Any,
    growth: Any,
    integral: Any,
    before: Any,
    rest: Any,
    lower: Any,
    upper: Any,
    gain: Any,
    *bounds: Any,
) -> tuple[Any, Any, Any]:
    """The input within its limits, the integrals after anti-windup, and that a step was made.

    `bounds` are, where windup is `bounded`, what integrals push beyond that; and the last input, the period and the
    largest rate, where that is limited.
    """
    wanted = rest + feedback
    u = clip(wanted, lower, upper)
    rates = bounds[1:] if bounded else bounds
    if rates:
        last, period, rate = rates
        u = clip(u, last - period * rate, last + period * rate)
    # Anti-windup: an integral that would push a saturated input further stands still.
    beyond = wanted - u + bounds[0] if bounded else wanted - u
    pushes = growth * (beyond @ gain)
    choices = zip(pushes, before, integral)
    return u, np.array([where(push > 0.0, old, new) for push, old, new in choices]), np.ones(1)
