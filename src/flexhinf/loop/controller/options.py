"""Options of a controller beside its law, checked before any work is lost: limits, period, bound of integral action,
and the input before the first sample.

A controller begins at rest at the state where its estimate begins. The input that holds the model there is the one with
zero acceleration of the driven states: u with f(x, u, 0) = 0, or the least-squares solution where the state is no
equilibrium. A state that is set later (`Controller.reset`, ``NAME_start`` of the exported C) gets its own input by the
same function, with the same bits.

Also here: how far integrals may push an input that has no limit of its own, or one so large that it is none. A sensor
that sticks is an error that never ends: without a bound, its integral grows to any input. With limits of the input the
anti-windup of the step is the bound; without, this one is, and where a limit lies further from the operating input than
the number w below. The integral action is c = K_e (e − e*), with the law's slope K at its operating point. At rest at a
command r the law needs c = G (r − r*), G = ∂u/∂r − K ∂x/∂r, on the line of equilibria x(r), u(r) of the model through
the operating point; a nonlinear law, gravity, loads and errors of the model need something more or less. So what c is
further from G (r − r*) than

    w + S |r − r*|,  w = Σᵢ sᵢ (|∂u/∂rᵢ| + ½ |K ∂x/∂rᵢ|),  S = ½ |G|,

is taken back of the integrals as an excess of the input is, with the travel sᵢ of the tracked state i: w is the input
that holds the robot over its travel, plus the law's output for an error of half of it. The input itself is not limited.

A law of no known model has no such line: there G = 0, and w and S have Σⱼ |Kⱼ| of all states in place of the slopes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from flexhinf.arrays import Vector
from flexhinf.codegen import Buffer, Call, Program, Slice, compile_program
from flexhinf.codegen.shared import share
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.loop.controller.estimated import EstimatedStates, constant_states
from flexhinf.notebook import names_text
from flexhinf.numerals import number_text
from flexhinf.plant import INTEGRAL, Estimator, Law, Plant, ProblemLaw
from flexhinf.scalars import drop_empty
from flexhinf.validation import checked_positive, real_array, real_number, value_text

#: Shortest and longest sampling period of a controller, s.
PERIODS = (1e-6, 1.0)


class Listed:
    """An option of a controller whose arguments are sequences."""

    def settings(self) -> dict[str, object]:
        """The arguments as lists, for a file."""
        return {name: np.array(value).tolist() for name, value in vars(self).items() if value is not None}


def checked_period(value: Any) -> float:
    """A sampling period, s, within `PERIODS`; else an InvalidInput asks for the unit that was probably meant."""
    period = checked_positive("The sampling period", value, "seconds", "1e-3 for 1 kHz")
    low, high = PERIODS
    if not low <= period <= high:
        rate = f", or {1.0 / period:g} for a rate of {period:g} Hz" if period >= 10.0 else ""
        meant = f"period={1e-3 * period:g} if {period:g} ms was meant{rate}"
        raise InvalidInput(
            "The sampling period is out of proportion.",
            f"expected {low:g} s to {high:g} s, got {period:g} s",
            meant if period > high else "a period in seconds: 1e-3 for 1 kHz",
        )
    return period


#: Time constant of the bias that decays after a transfer, s.
BLEND_TIME = 0.5

#: Longest latency that an estimator predicts over, samples: each beyond the first costs a step one more time update.
LONGEST_LATENCY = 10

#: Latency of a controller with an estimator that states none, samples: an input is written when the next sample begins.
LATENCY = 1


def checked_latency(value: Any, estimator: Any) -> int:
    """Samples between a measurement and the effect of its input; by default (None) `LATENCY`, or 0 without an
    estimator. What is no latency, or needs an estimator, is refused."""
    if value is None:
        return 0 if estimator is None else LATENCY
    samples = real_number(value)
    most = 0 if estimator is None else LONGEST_LATENCY
    if isinstance(value, bool) or not (0 <= samples <= most and samples == int(samples)):
        raise InvalidInput(
            "The latency cannot be predicted over."
            if estimator is None
            else "The latency is no number of samples.",
            f"expected a whole number from 0 to {most}"
            f"{', as nothing predicts the state without an estimator' if estimator is None else ''}, "
            f"got {value_text(value)}",
            "an estimator, or latency=0" if estimator is None else "latency=1, or a longer period",
        )
    return int(samples)


def checked_blend_time(value: Any, takes_over: bool) -> float:
    """Time constant of the bias of a transfer, s, by default `BLEND_TIME`; refused where no law `takes_over`."""
    if value is None:
        return BLEND_TIME
    refuse_if(
        not takes_over,
        "A time constant is given for a bias that never is.",
        f"expected blend_time=None for one law that starts from zero, got {value_text(value)}",
        "start='bumpless', or a Schedule of several laws",
    )
    return checked_positive("The time constant of the bias", value, "seconds", "blend_time=0.5")


def checked_offset_time(value: Any, estimator: Estimator | None) -> float | None:
    """Time constant of the offsets, s, or None; refused without an estimator, which alone expects a measurement."""
    if value is None:
        return None
    if estimator is None:
        raise InvalidInput(
            "Offsets of the true state are stated: this controller measures nothing else.",
            f"expected offset_time=None without an estimator, got {value_text(value)}",
            "an estimator",
        )
    return checked_positive("The time constant of the offsets", value, "seconds", "offset_time=1.0")


def checked_measurement_limits(value: Any, estimator: Estimator | None) -> tuple[np.ndarray, ...] | None:
    """Least and largest measurements and largest rates (p,) of (lower, upper, rate), numbers or (p,); None for none.
    What does not fit is refused, and any without an estimator, as nothing would stand in for what is missing."""
    if value is None:
        return None
    triple = isinstance(value, (tuple, list)) and len(cast("Sequence[Any]", value)) == 3
    refuse_if(
        estimator is None or not triple,
        "The limits of the measurements cannot be used.",
        f"expected (lower, upper, rate) and an estimator, got {value_text(cast(object, value))}"
        + " without an estimator" * (estimator is None),
        f"measurement_limits={LIMITED['measurement_limits']}",
    )
    assert estimator is not None
    names = ("measurement_limits", "measurement_limits")
    limits = Limits.of((value[0], value[1]), len(estimator.plant.outputs), value[2], names)
    return limits.lower, limits.upper, limits.rate


@dataclass(frozen=True, eq=False)
class Limits:
    """Lower and upper limits of some signals, and of their rates, (m,) each, infinite where there is none."""

    lower: np.ndarray
    upper: np.ndarray
    rate: np.ndarray

    def texts(self, units: Sequence[str]) -> list[str]:
        """Each range with its unit, for a summary."""
        ranges = zip(self.lower.tolist(), self.upper.tolist(), units, strict=True)
        return [f"{low:.4g} to {number_text(high, unit)}" for low, high, unit in ranges]

    @staticmethod
    def of(
        saturation: Any, inputs: int, rate: Any = None, names: tuple[str, str] = ("saturation", "input_rate")
    ) -> Limits:
        """Limits of m signals: the range from None, a number (±), an array with one number (±) each, or a tuple (lower,
        upper) of them; the largest rate per second from None, a number or (m,). The names are those of both arguments.

        What has another shape, does not keep lower < upper, or is no positive rate is an InvalidInput.
        """
        name, rate_name = names

        def ends(value: Any, name: str, advice: str) -> np.ndarray:
            try:
                return np.array(np.broadcast_to(real_array(value), (inputs,)))
            except (TypeError, ValueError) as error:
                what = {"saturation": "inputs", "input_rate": "inputs", "measurement_limits": "outputs"}.get(
                    name, "command"
                )
                raise InvalidInput(
                    f"The {LIMITS[name]} does not fit the {what}.",
                    f"expected one number or {inputs}, got {value_text(value)}",
                    f"{name}={advice}",
                ) from error

        rates = np.full(inputs, np.inf) if rate is None else ends(rate, rate_name, "2.0 per second")
        if not np.all(rates > 0.0):
            raise InvalidInput(
                f"The {LIMITS[rate_name]} is not positive.",
                f"expected numbers > 0 per second, got {value_text(rate)}",
                f"{rate_name}={LIMITED.get(name, '2.0, or one per signal')}",
            )
        if saturation is None:
            return Limits(np.full(inputs, -np.inf), np.full(inputs, np.inf), rates)
        advice = LIMITED.get(name, f"48.0 for ±48, or {name}=(lower, upper)")
        parts = cast("tuple[Any, ...]", saturation) if isinstance(saturation, tuple) else ()
        pair = len(parts) == 2
        both: list[Any] = [*parts] if pair else [saturation, saturation]
        lower, upper = (ends(part, name, advice) for part in both)
        lower = lower if pair else -upper
        if not np.all(lower < upper):
            raise InvalidInput(
                f"The {LIMITS[name]} leaves no room.",
                f"expected lower < upper, got lower={lower.tolist()}, upper={upper.tolist()}",
                f"{name}={advice}",
            )
        return Limits(lower, upper, rates)


#: What the limits of a controller are called, by the names of its arguments.
LIMITS = {
    "saturation": "saturation",
    "input_rate": "rate of the input",
    "command_range": "range of the command",
    "command_rate": "rate of the command",
    "measurement_limits": "limit of the measurements",
}


#: What measurement_limits may be, for the advice of a refusal.
LIMITED = {"measurement_limits": "(-3.1, 3.1, 6.0), in the unit of the measurement, and per second"}


def command_limits(command_range: Any, command_rate: Any, tracked: Sequence[str], moving: bool) -> Limits:
    """Limits of a standing command, from the arguments of a controller; refused beside a moving reference, whose
    velocity and input would no longer fit its position, and where nothing is commanded."""
    if (command_range is None and command_rate is None) or (tracked and not moving):
        return Limits.of(command_range, len(tracked), command_rate, ("command_range", "command_rate"))
    raise InvalidInput(
        "A limit of the command is given where positions are not commanded alone.",
        f"expected a law with integrals and moving=False, got moving={moving} and {len(tracked)} integrals",
        "check_reference(robot, reference, duration) before the move; a plan (JerkLimited) has a largest velocity",
    )


def dead_zone(value: Any, tracked: Sequence[str]) -> np.ndarray | None:
    """Largest errors (k,) that are not integrated, of a number or one per tracked state; None without any. What does
    not fit or is negative is refused, and any where nothing is integrated."""
    if value is None:
        return None
    zone = real_array(value)
    if not tracked or zone.shape not in ((), (len(tracked),)) or not np.all(zone >= 0.0):
        raise InvalidInput(
            "The dead zone of the integrals does not fit.",
            f"expected one number >= 0 or one for each of the integrated {list(tracked)}, got {value_text(value)}",
            "integral_dead_zone=1e-3" if tracked else "integral_dead_zone=None, as this law tracks nothing",
        )
    return np.array(np.broadcast_to(zone, (len(tracked),))) if zone.any() else None


def check_names(law: Law, estimator: Estimator | None, period: float) -> None:
    """Refuse a law whose states are not the plant's, then integrals; an estimator of other states or period."""
    states, tracked = law.plant_states, law.tracked
    order = (*states, *(name + INTEGRAL for name in tracked))
    if order != tuple(law.state_names) or not set(tracked) <= set(states):
        raise InvalidInput(
            "The law's states are not the plant's states followed by integrals of some of them.",
            f"got {list(law.state_names)}",
            "name the integral of the error of NAME 'NAME_integral', last",
        )
    if estimator is None:
        return
    plant, inputs = estimator.plant, tuple(law.input_names)
    if not set(states) <= set(plant.states) or tuple(plant.inputs) != inputs:
        raise InvalidInput(
            "The estimator and the law do not mean the same states and inputs.",
            f"the law needs {list(states)} and {list(inputs)}, "
            f"the estimator's plant has {list(plant.states)} and {list(plant.inputs)}",
            "the same plant for both, or plant.augmented(...) for the estimator",
        )
    if abs(estimator.period - period) > 1e-12 * period:
        raise InvalidInput(
            "The estimator and the controller run at different periods.",
            f"expected {period} s, got {estimator.period} s",
            "the same period for both",
        )


#: Travel of a tracked state without a range, in its unit: half a turn, or m.
TRAVEL = np.pi

#: How much of the law's answer is spare, on both sides.
SPARE = 0.5


@dataclass(frozen=True, eq=False)
class Windup:
    """Bound of the integral action (anti-windup), for L laws of m inputs and k integrals.

    `limit` (m,) is w, infinite for inputs that their own limits keep within w of the operating input; `line` and
    `spread` are G and S, (L, m, k), or (m, k) of one law.
    """

    limit: np.ndarray
    line: np.ndarray
    spread: np.ndarray

    def check(self, laws: Sequence[Law]) -> None:
        """Refuse numbers of a file whose shapes do not fit these laws, or that are NaN or, but for limits, infinite."""
        size = (len(laws[0].input_names), len(laws[0].tracked))
        shape = size if len(laws) == 1 else (len(laws), *size)
        fits = [np.shape(part) for part in (self.limit, self.line, self.spread)] == [size[:1], shape, shape]
        if not fits or not np.all(self.limit >= 0.0) or not np.isfinite([self.line, self.spread]).all():
            raise InvalidInput(
                "The bound of the integrals does not fit the law.",
                f"expected numbers for {size[0]} inputs and {size[1]} integrals, got {value_text(vars(self))}",
                "windup=None: the bound of law and model",
            )

    @staticmethod
    def of(
        laws: Sequence[Law], slopes: Sequence[np.ndarray], estimator: Estimator | None, inputs: Limits
    ) -> Windup:
        """The default bound for these laws, with slopes ∂u/∂x (m, n), and limits of the inputs."""
        limits, lines, spreads = (
            np.stack(parts)
            for parts in zip(*(_bounds(law, slope, estimator) for law, slope in zip(laws, slopes)))
        )
        limit = limits.max(axis=0)
        ends = inputs.lower, inputs.upper
        room = np.max([np.abs(end - law.operating_input) for law in laws for end in ends], axis=0)
        limit = np.where(room > limit, limit, np.inf)
        return Windup(limit, lines, spreads) if len(laws) > 1 else Windup(limit, lines[0], spreads[0])


def _bounds(
    law: Law, slope: np.ndarray, estimator: Estimator | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    names = law.plant_states
    n, places = len(names), [names.index(name) for name in law.tracked]
    point, u = (np.asarray(part, dtype=float) for part in (law.operating_point, law.operating_input))
    slope = slope[:, :n]
    own = law.problem.plant if isinstance(law, ProblemLaw) else None
    model = own if estimator is None else estimator.plant
    travel = TRAVEL + np.abs(point[places])
    along, held = None, None
    if model is not None:
        states = EstimatedStates.of(law, estimator)
        along, held = equilibrium_line(
            model, states.whole(point[:n]), u, [model.index(name) for name in law.tracked]
        )
        along = None if along is None else states.own(along)
    if model is None or along is None or held is None:
        size = np.repeat(np.abs(slope).sum(axis=1, keepdims=True), len(places), axis=1)
        return size @ travel, np.zeros_like(size), size
    for k, place in enumerate(places):
        ends = np.array(model.limits.get(names[place], (-np.inf, np.inf)), dtype=float)
        travel[k] = min(travel[k], np.abs(ends - point[place]).max())
    reaction = slope @ along
    line = held - reaction
    return (np.abs(held) + SPARE * np.abs(reaction)) @ travel, line, SPARE * np.abs(line)


def equilibrium_line(model: Plant, x: np.ndarray, u: np.ndarray, places: list[int]) -> tuple[Any, Any]:
    """∂x/∂r (n, k) and ∂u/∂r (m, k) of the equilibria through (x, u), r the states at `places`; None and None where the
    model has no slope there. States that are constant stay."""
    a, b, _ = model.change_slopes(x, u)
    still = [*places, *constant_states(model, x, u)]
    rows = np.block([[a, b], [np.eye(len(x))[still], np.zeros((len(still), len(u)))]])
    if not np.isfinite(rows).all():
        return None, None
    line = np.linalg.lstsq(rows, np.eye(len(rows))[:, len(x) : len(x) + len(places)], rcond=None)[0]
    return line[: len(x)], line[len(x) :]


class FirstInput:
    """The input (m,) of a controller before its first sample.

    `before_first` is as for `flexhinf.Controller`, "hold", "zero" or (m,), and `limits` are those of the input; what
    is none of these, or not within the limits, is an InvalidInput. `is_zero` says whether the input is zero wherever
    the controller starts, and `text` the option in words, for a summary.
    """

    def __init__(self, before_first: Any, law: Law, estimator: Estimator | None, limits: Limits) -> None:
        self.law, self.estimator, self.limits = law, estimator, limits
        named = isinstance(before_first, str)
        if named and before_first not in ("hold", "zero"):
            raise InvalidInput(
                "There is no such input before the first measurement.",
                f"expected 'hold', 'zero' or one number per input, got {value_text(before_first)}",
                "before_first='zero' for motors that stay without power until there is a measurement",
            )
        self.option: str | Vector = before_first if named else self._checked(before_first)
        self.is_zero = named and before_first == "zero"
        self.text = "zero" if self.is_zero else "what holds the robot where the estimate begins"

    def at(self, input: Any = None, state: Any = None) -> np.ndarray:
        """The input (m,): `input` if it fits, else an InvalidInput; by default that of `before_first`, for the estimate
        `state` (n,) or where the estimate begins."""
        if input is not None:
            return self._checked(input)
        if state is None or self.is_zero:
            return self.own.copy()
        assert self.estimator is not None  # without one there is no state to tell
        place = real_array(state)
        if np.array_equal(place, self.estimator.initial[0]):
            return self.own.copy()
        plant, u = self.estimator.plant, np.zeros(len(self.own))
        every = {"x": place, "p": plant.parameters.vector(), "u": u}
        arrays = {name: array for name, array in every.items() if array.size}

        def build() -> Any:
            buffers = tuple(
                Buffer(name, array.size, "out" if name == "u" else "in") for name, array in arrays.items()
            )
            *inputs, held = (Slice(name, size=array.size) for name, array in arrays.items())
            call = Call(holding_function(plant), tuple(inputs), (held,))
            return compile_program(Program("holding", buffers, (call,), ()))

        share(("holding kernel", plant.code_key), build).run(arrays, {})
        return self._within(u) if np.isfinite(u).all() else self.own.copy()

    @cached_property
    def own(self) -> np.ndarray:
        """Input (m,) where the estimate begins, within the limits."""
        if not isinstance(self.option, str):
            return self.option
        u, estimator = np.array(self.law.operating_input, dtype=float), self.estimator
        if estimator is None or self.is_zero:
            return self._within(np.zeros_like(u) if self.is_zero else u)
        mean = np.asarray(estimator.initial[0], dtype=float)
        if not np.array_equal(mean, np.asarray(self.law.operating_point, dtype=float)[: len(mean)]):
            arguments = [array for array in (mean, estimator.plant.parameters.vector()) if array.size]
            held = np.ravel(np.asarray(holding_function(estimator.plant)(*arguments), dtype=float))
            u = held if np.isfinite(held).all() else u
        return self._within(u)

    def _within(self, u: np.ndarray) -> np.ndarray:
        return np.clip(u, self.limits.lower, self.limits.upper) + 0.0  # no negative zero

    def _checked(self, value: Any) -> np.ndarray:
        names, limits = tuple(self.law.input_names), self.limits
        u = real_array(value)
        u = u.reshape(1) if u.shape == () else u
        if u.shape != (len(names),) or not np.all((u >= limits.lower) & (u <= limits.upper) & np.isfinite(u)):
            raise InvalidInput(
                "The input before the first sample does not fit.",
                f"expected a finite value for each of {list(names)} within {limits.lower.tolist()} and "
                f"{limits.upper.tolist()}, got {value_text(value)}",
                "the input that acts when the controller takes over",
            )
        return np.array(u)


def holding_function(plant: Plant) -> Any:
    """(x, parameters) → u, the input that holds a plant at a state, as a CasADi function without empty arguments.

    u = −(BᵀB)⁻¹Bᵀ f(x, 0, 0) with B = ∂f/∂u at u = 0: exact where f is affine in u and some u holds x. Of a map, f is
    x⁺ − x.
    """

    def build() -> Any:
        import casadi as ca

        flow = plant.traced_flow
        x, u, d, p = (ca.SX.sym(name, flow.size1_in(k)) for k, name in enumerate("xudp"))
        rates = flow(x, u, d, p) - x if plant.sampled else flow(x, u, d, p)
        none = ca.vertcat(u, d), ca.SX.zeros(u.numel() + d.numel())
        rates, slope = (ca.substitute(part, *none) for part in (rates, ca.jacobian(rates, u)))
        held = -ca.solve(ca.mtimes(slope.T, slope), ca.mtimes(slope.T, rates))
        return drop_empty(ca.Function("holding", [x, p], [ca.densify(held)], {"cse": True}))

    return share(("holding", plant.code_key), build)


def _kind_of_input(name: str) -> tuple[str, str]:
    """Quantity and unit of an input, as text: ("voltage", " V") of motor_voltage_elbow; no unit where joints differ."""
    units = {"voltage": " V", "current": " A", "torque": "", "force": ""}
    return next(((word, unit) for word, unit in units.items() if word in name.split("_")), ("input", ""))


def _plausible_text(low: float, high: float, rate: float, unit: str) -> str:
    """Those limits of a measurement that there are, in words."""
    texts: list[str] = []
    unit = f" {unit}" * bool(unit)
    if np.isfinite([low, high]).any():
        texts.append(f"{low:.4g} to {high:.4g}{unit}")
    if np.isfinite(rate):
        texts.append(f"at most {rate:.4g}{unit} per s")
    return ", ".join(texts)


def controller_facts(c: Any) -> dict[str, str]:
    """What a controller says of itself: law, estimator, period, limits, and what is measured and commanded."""
    limits, command, mode = c.limits, c.command_limits, c.mode
    units: Mapping[str, str] = {} if c.estimator is None else c.estimator.plant.units
    input_units = [units.get(name, "") for name in c.law.input_names]
    tracked_units = [units.get(name, "") for name in c.tracked]
    law, zone = ", ".join(dict.fromkeys(law.kind for law in c.laws)), c.integral_dead_zone
    facts = {
        "law": law if len(c.laws) == 1 else f"{len(c.laws)} laws ({law})",
        "estimator": "none (state feedback)" if c.estimator is None else type(c.estimator).__name__,
        "period": number_text(c.period, "s"),
        "measured": names_text(c.measured)
        + ("" if mode.checks_measurements else ", not checked for plausibility"),
        "stops for": "" if c.protection is None else ", ".join(c.protection.stop_on),
        "tracked": names_text(c.tracked),
        "inputs": names_text(tuple(c.law.input_names)),
        "saturation": ", ".join(limits.texts(input_units))
        if np.isfinite([limits.lower, limits.upper]).any()
        else "",
        "integral action": ", ".join(
            f"adds at most {size:.4g}{unit} to the holding {kind}"
            for name, size in zip(c.law.input_names, c.windup.limit)
            if np.isfinite(size)
            for kind, unit in [_kind_of_input(name)]
        )
        if mode.bounds_windup
        else "",
        "input rate": ", ".join(
            f"at most {number_text(rate, unit)} per s" for rate, unit in zip(limits.rate, input_units)
        )
        if mode.limits_input_rate
        else "",
        "command": ", ".join(
            f"{text}, at most {number_text(rate, unit)} per s"
            for text, rate, unit in zip(command.texts(tracked_units), command.rate, tracked_units)
        )
        if mode.limits_command
        else "",
        "integral dead zone": ""
        if zone is None
        else ", ".join(f"± {number_text(size, unit)}" for size, unit in zip(zone, tracked_units)),
        "reference": "moving" if mode.moving else "",
        "dry friction": ", ".join(map(number_text, c.dry_friction.level, input_units))
        if c.dry_friction
        else "",
        "backlash": ", ".join(map(number_text, c.backlash.width, tracked_units)) if c.backlash else "",
        "brought back": "" if c.governor is None else c.governor.text_in(tracked_units),
        "workspace": "" if c.supervision is None else c.supervision.box_text(tracked_units),
        "reactions": "" if c.supervision is None else c.supervision.reactions_text(tracked_units),
        "estimated too": ", ".join(name for name in c.estimated if name not in c.states),
        "compensated": ", ".join(c.estimated[k] for k in mode.compensated),
        "offsets": f"decay with {c.offset_time:g} s" if mode.has_offset else "",
        "measurements": ", ".join(
            f"{name} {text}"
            for name, low, high, rate in zip(c.measured, *c.measurement_limits)
            if (text := _plausible_text(low, high, rate, units.get(name, "")))
        )
        if c.measurement_limits is not None
        else "",
        "latency": f"{mode.latency} sample{'s' * (mode.latency > 1)}" if mode.latency else "",
    }
    return {name: fact for name, fact in facts.items() if fact}
