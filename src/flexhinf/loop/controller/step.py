"""One step of a sampled controller: estimator, integrals, law, saturation, as NumPy code.

It is what the compiled kernels run, what `Controller.step` calls and what is exported later. How its functions
are called is left to a *run*: directly on arrays, or as pieces of a program (`flexhinf.codegen.compose`). The law is
evaluated by its own text, or as a table of monomials in loops.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from flexhinf.codegen import DIRECT, Block, Composer
from flexhinf.loop.controller.options import Mode, Source
from flexhinf.loop.controller.schedule import bumpless_transfer, chosen
from flexhinf.plant import Estimator, Law
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import PolynomialLaw
from flexhinf.scalars import absolute, clip, jacobian, where

#: Coefficients from which a polynomial law is a table. Below, its text as one piece is faster.
TABLE = 500


@dataclass(frozen=True, eq=False)
class LawCode:
    """A law and the form of its numbers in a kernel.

    From `TABLE` coefficients on, a controller that is `composed` of pieces evaluates a polynomial law
    (`Law.law_table`) in loops, in nested form: the table of its coefficients has one row per monomial and one column
    per input, padded with zero columns so that rows fill vectors.
    """

    law: Law
    composed: bool

    @cached_property
    def table(self) -> PolynomialLaw | None:
        """The polynomial, where the law is evaluated as a table."""
        large = np.size(self.law.law_data) >= TABLE
        return self.law.law_table if large and self.composed and not self.law.depends_on_reference else None

    @property
    def columns(self) -> int:
        """Columns of the table: inputs, and padding to 1, 2, 4 or a multiple of 8."""
        inputs = len(self.law.input_names)
        return next((power for power in (1, 2, 4) if inputs <= power), -(-inputs // 8) * 8)

    @cached_property
    def data(self) -> np.ndarray:
        """The law's numbers as the kernel has them, flat."""
        if self.table is None:
            return np.ravel(self.law.law_data)
        rows = self.table.coefficients.T
        return np.pad(rows, ((0, 0), (0, self.columns - rows.shape[1]))).ravel()

    @cached_property
    def slope(self) -> np.ndarray:
        """∂u/∂x at the operating point, (m, n)."""
        n, data = len(self.law.state_names), np.ravel(self.law.law_data)
        if self.table is None:
            return jacobian(self.law.evaluate_law, n, data.size)(np.zeros(n), data)[1]
        degrees = self.table.degrees
        before = sum(basis.count(n, k) for k in degrees if k < 1)
        linear = self.table.coefficients[:, before : before + n]
        return linear if 1 in degrees else np.zeros_like(linear)

    def on(
        self, run: Any, data: Any, active: Any = None, about: tuple[Any, Any] | None = None
    ) -> Callable[[Any], Any]:
        """k as a function of a deviation x (n,) on the run, with numbers (L · size,) as in `data`, of one law after the
        other, of which `active` (L,) is 1 for the law that is meant, else 0; about the moving reference (n without
        integrals,) and its input (m,), x* and u* by default."""
        if self.table is not None and isinstance(run, Composer):
            return partial(self._from_table, run, data, active)
        if active is not None:
            data = run.call(operator.matmul, active, data.reshape(len(active), self.data.size))
        if self.table is not None:
            data = data.reshape(-1, self.columns)[:, : len(self.law.input_names)].T.ravel()
        if about is not None and self.law.depends_on_reference:
            return lambda x: run.call(self.law.evaluate_about, x, *about, data)
        return lambda x: run.call(self.law.evaluate_law, x, data)

    def _from_table(self, run: Composer, data: Block, active: Block | None, x: Block) -> Block:
        """The polynomials of the active law alone."""
        assert self.table is not None
        inputs, size, degrees = len(self.law.input_names), self.data.size, self.table.degrees
        if active is None:
            return run.polynomial(x, data[:size], degrees, inputs)
        totals = []
        for law in range(len(active)):
            with run.when(active[law : law + 1]):
                totals.append(run.polynomial(x, data[law * size : (law + 1) * size], degrees, inputs))
        return run.call(_chosen, active, *totals)


def _chosen(active: Any, *values: Any) -> Any:
    """The active law's value; the others may never have been computed."""
    return sum(where(flag > 0.5, value, 0.0) for flag, value in zip(active, values, strict=True))


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

    Without an estimator, y is the state of the plant that the law was designed for, (p,); without a measurement (None)
    the prediction stands for the estimate and for what is measured. The command r is (k,), or of a moving reference
    (x_d, u_d), (n + m,). `memory` and `data` are namespaces as `Controller.memory` and `Controller.data` lay them out.

    Returns the input (m,), the estimate x(k|k) (n,), and the memory for the next step by name.
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
        taken = run.call(partial(np.subtract, 1.0), memory.started)  # 1 at the first sample, else 0
    rest = r[len(estimate) :] if mode.moving else rest
    others = (*((r,) if mode.moving else ()), *((data.integral_dead_zone,) if mode.has_dead_zone else ()))
    position, growth, integral, deviation = run.call(
        partial(_deviation, tracked, mode.moving), y, estimate, memory.position, held, memory.integral,
        memory.started, data.period, point, *others,
    )  # fmt: skip
    about: Any = None
    if (
        mode.moving and law.law.depends_on_reference
    ):  # in memory of its own: loops inside a sample may read it
        states = len(estimate)
        about = run.call(lambda r: (r[:states], r[states:]), r)
    law_of = law.on(run, data.law, active, about)
    feedback = law_of(deviation)
    after = {"position": position, "reference": requested, "command": r, "active": active}
    if mode.takes_over:
        wanted = run.call(np.subtract, memory.u, rest)
        feedback, growth, integral, after["bias"] = bumpless_transfer(
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


def _deviation(tracked: Sequence[Source], moving: bool, *arrays: Any) -> tuple[Any, Any, Any, Any]:
    """Tracked positions, growth of the integrals, integrals, and the law's argument: x − x*, or x − x_d about the
    moving reference of this sample."""
    y, estimate, last, reference, integral, started, period, point, *others = arrays
    n, places = len(estimate), [source.state for source in tracked]
    position = _positions(tracked, y, estimate)
    if moving:
        # ė = x_i − x_di, both of which move between samples: the error goes in by the trapezoidal rule.
        error = 0.5 * ((last - reference[places]) + (position - others[0][places]))
    else:
        # ė = x_i − x_d: the command is held between samples, as u is; x_i goes in by the trapezoidal rule.
        error = 0.5 * (last + position) - reference
    for zone in (
        others[1:] if moving else others
    ):  # what lies beyond the dead zone ±zone (k,), where there is one
        error = error - clip(error, -zone, zone)
    growth = started * period * error
    integral = integral + growth
    if moving:
        deviation = np.concatenate([np.asarray(estimate) - others[0][:n], integral - point[n:]])
    else:
        deviation = np.concatenate([np.asarray(estimate), integral]) - point
    return position, growth, integral, deviation


def _positions(tracked: Sequence[Source], y: Any, estimate: Any) -> np.ndarray:
    """The tracked states, (k,)."""
    return np.array([(y if source.measured else estimate)[source.place] for source in tracked])


def _limited(
    tracked: Sequence[Source], y: Any, estimate: Any, r: Any, last: Any, started: Any, *data: Any
) -> Any:
    """The command (k,) within its range, and as near to the last one, at first the positions, as its rate says."""
    period, lower, upper, rate = data
    last = where(started[0] > 0.5, last, _positions(tracked, y, estimate))
    return clip(clip(r, lower, upper), last - period * rate, last + period * rate)


def _wound(places: Sequence[int] | None, integral: Any, point: Any, gain: Any, r: Any, *bound: Any) -> Any:
    """What integrals push (m,) beyond their bound, see `flexhinf.loop.controller.start`; about a moving reference,
    which has no `places`, the law needs none of it at rest."""
    line, spread, limit = bound
    pushed = gain @ (integral - point[len(point) - len(integral) :])
    if places is not None:
        away = r - point[places]
        pushed, limit = pushed - line @ away, limit + spread @ absolute(away)
    return pushed - clip(pushed, -limit, limit)


def _input(
    bounded: bool, feedback: Any, growth: Any, integral: Any, before: Any, *data: Any
) -> tuple[Any, Any, Any]:
    """The input within its limits, the integrals after anti-windup, and that a step was made.

    Behind u*, both limits and the gain of the integrals come, where windup is `bounded`, what integrals push beyond
    that; and the last input, the period and the largest rate, where that is limited.
    """
    rest, lower, upper, gain, *bounds = data
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
