"""One step of a sampled controller: estimator, integrals, law, saturation, as NumPy code.

The same code is compiled to kernels, called by `Controller.step`, and exported as C. How its functions are called is
left to a *run*: directly on arrays, or as pieces of a program (`flexhinf.codegen.compose`). The law is evaluated by its
own code, or as a table of monomials in loops.

Of several laws, designed at several poses, the nearest to the command is active. When a law takes over, the input
continues from the last one: bumpless transfer. The integrals are the memory of a law, so they are chosen such that its
output is the input that acts already: u* + k(x − x*, e) = u_last, by a fixed number of Broyden's steps [broyden1965]
from the integrals as they are and the inverse slope at the operating point. The part that no integral can supply (a law
without integrals, fewer integrals than inputs, a polynomial without such a root) is held as a bias that decays, so that
the input is continuous always. Every step is one evaluation of the law, so that it may be a polynomial of any degree;
composed kernels make them only when a law takes over.

Where the input is limited, integrals follow what acts (anti-windup): of what the law asks for beyond it, a fifth per
sample is taken back of the integral that the input belongs to, see `flexhinf.loop.controller.data.integral_relief`.

With a latency of N samples, the input computed from y(k) acts from sample k + N on. The memory has the inputs that
wait; `predict_ahead` follows the estimator's model over them, and the law reads the state at which its input acts
[manitius1979]. Integrals count what is measured, so they end at sample k. A moving reference is that of sample k + N
too, and the integrals compare y(k) with the one given N samples before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from flexhinf.codegen import DIRECT, gives
from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.backlash import Place, engaged
from flexhinf.loop.controller.friction import modelled, overcoming
from flexhinf.loop.controller.governor import believed, braked, brought_back, unwound
from flexhinf.loop.controller.law_code import LawCode
from flexhinf.loop.controller.measured import Source, as_measured, corrected, faded, positions, standing
from flexhinf.loop.controller.readings import believed_readings, refusals
from flexhinf.loop.controller.signs import Seen, Watch, signs
from flexhinf.loop.controller.status import doubted, eased, eases, observed, reaction
from flexhinf.plant import Estimator
from flexhinf.scalars import absolute, clip, where
from flexhinf.validation import checked_kind, value_text


@dataclass(frozen=True)
class StepMode:
    """Options that change the code of a step, beside law and estimator.

    `moving`: the law acts about a moving reference (x_d, u_d) instead of the operating point. `start`: the integrals at
    the first sample are "zero", or such that the input continues from the one before, "bumpless". Of `laws` one is
    active at a time. The flags say what has limits (the input itself always may), whether small errors are not
    integrated, and whether integral action is bounded, as some input has no limit. `latency`: samples between a
    measurement and the effect of the input computed from it. `reactions`: to the events of
    `flexhinf.loop.controller.status`, empty without a supervision. `has_offset`: offsets of the first measurement are
    taken in slowly. `own`: places of the law's states in the estimate, where that has more; `compensated`: those of
    loads that the input balances. `checks_measurements`: what is out of its range, or moves too fast, is missing.
    `speeds`: places of the motors' velocities, where dry friction is overcome by them.
    `velocities`: places of the law's states that are zero at rest, where a moving reference may be held. `gaps`: places
    of links and motors with backlash between them. `governed`: of each tracked position, those of the states that are
    shifted with it, where far joints are brought back slowly; `resisted`: those of the velocities in the estimate,
    where they let go of what keeps them; `turned`: T of joints that are coupled; `curved`: whether springs have curves
    that the estimator's model has not. `protected`: what the signs of a protective stop are read from.
    """

    moving: bool = False
    start: str = "zero"
    laws: int = 1
    limits_command: bool = False
    limits_input_rate: bool = False
    has_dead_zone: bool = False
    bounds_windup: bool = False
    latency: int = 0
    reactions: tuple[str, ...] = ()
    has_offset: bool = False
    own: tuple[int, ...] = ()
    compensated: tuple[int, ...] = ()
    checks_measurements: bool = False
    speeds: tuple[int, ...] = ()
    velocities: tuple[int, ...] = ()
    gaps: tuple[Place, ...] = ()
    governed: tuple[tuple[int, ...], ...] = ()
    resisted: tuple[int, ...] = ()
    turned: tuple[tuple[float, ...], ...] = ()
    curved: bool = False
    protected: Watch | None = None

    @property
    def eases(self) -> bool:
        """Whether some reaction holds the robot without a jump of the input."""
        return eases(self.reactions)

    @property
    def command_lead(self) -> int:
        """Samples by which a moving reference is given ahead of its instant: those of the latency."""
        return self.latency if self.moving else 0

    @property
    def reacts(self) -> bool:
        """Whether there is a reaction to any event."""
        return any(reaction != "none" for reaction in self.reactions)

    @property
    def brakes(self) -> bool:
        """Whether some event slows the path of the command."""
        return "brake" in self.reactions

    @property
    def changes_command(self) -> bool:
        """Whether the law may act on another command than was requested."""
        return self.limits_command or bool(self.governed) or bool({"hold", "limit"} & set(self.reactions))

    def __post_init__(self) -> None:
        checked_kind(
            "Whether the law acts about a moving reference is not said.",
            self.moving,
            bool,
            "moving=True or moving=False",
            "moving=True for commands (x_d, u_d) of states and inputs",
        )
        if self.start not in ("zero", "bumpless"):
            raise InvalidInput(
                "There is no such start of a controller.",
                f"expected 'zero' or 'bumpless', got {value_text(self.start)}",
                "start='bumpless' to continue from the last input",
            )

    @property
    def takes_over(self) -> bool:
        """Whether a law ever takes over: at the first sample, or from another law."""
        return self.start == "bumpless" or self.laws > 1


STANDING = StepMode()


def controller_step(
    law: LawCode,
    estimator: Estimator | None,
    tracked: Sequence[Source],
    y: Any,
    r: Any,
    memory: Any,
    data: Any,
    run: Any = DIRECT,
    mode: StepMode = STANDING,
) -> tuple[Any, Any, dict[str, Any]]:
    """One step of the controller, pure, on any element.

    Without an estimator, y is the state of the plant that the law was designed for, (p,). An element of a measurement
    that is no finite number is missing: the others correct the estimate, which replaces it where it is tracked. The
    command r is (k,), or of a moving reference (x_d, u_d), (n + m,). `memory` and `data` are namespaces as
    `Controller.memory` and `Controller.data` lay them out.

    Returns the input (m,), the whole estimate x(k|k), and the memory for the next step by name.
    """
    estimate: Any = y
    belief: Any = None
    queue, acted, waiting = None, memory.u, []
    turns, read, repeated, expected = (), y, None, None
    if mode.latency:
        run.section("Inputs that wait for their instant, and the one that acted until this sample")
        queue, *waiting, acted = run.call(_waiting, memory.u, memory.queue)
    if mode.speeds and estimator is not None:
        run.section("These inputs less what dry friction takes, which the estimator's model does not have")
        acted_on = memory.command if mode.changes_command else memory.reference
        commands = [acted_on, *(run.call(_rows, memory.commands) if mode.latency else ())]
        *waiting, acted = (
            run.call(partial(modelled, mode.speeds), u, command, data.dry_friction)
            for u, command in zip([*waiting, acted], commands, strict=True)
        )
    beliefs, ahead, push, doubt, seen, gap, means = [], estimate, None, None, None, None, ()
    offset = [memory.offset, memory.offset_known] if mode.has_offset else [None, None]
    if estimator is not None:
        belief = type(estimator.initial)(*memory.belief)
        measurement, turns, there = y, estimator.plant.angle_places(estimator.plant.outputs), None
        if mode.has_offset or mode.checks_measurements:
            expected = run.call(estimator.plant.evaluate_output, belief.mean, acted, data.parameters)
        if mode.checks_measurements:
            run.section("Readings that are believed")
            y, seen, there, repeated = run.call(
                partial(believed_readings, turns), y, expected, memory.readings, data.period, data.measurement_lower,
                data.measurement_upper, data.measurement_rate, data.reading_steps, data.reading_windows,
            )  # fmt: skip
        read = y
        if mode.has_offset:
            y, *offset = run.call(partial(faded, turns), y, expected, *offset, data.offset_decay)
        if mode.gaps:
            y, gap = run.call(partial(engaged, mode.gaps, turns), y, r, data.backlash)
        predicted = belief.mean
        belief, y = corrected(run, estimator, belief, y, acted, data)
        means = predicted, belief.mean
        seen = run.call(refusals, seen, measurement, there, y) if mode.checks_measurements else None
        estimate = belief.mean
        if "rcond" in belief._fields:
            doubt = run.call(doubted, belief.rcond, data.rcond_limit, memory.doubt)
        if waiting:
            run.section("Prediction to the instant at which the input acts")
        beliefs = predict_ahead(run, estimator, belief, waiting[::-1], data)
        ahead = [belief, *beliefs][-1].mean
    whole = estimate
    if mode.own:
        loads = ahead
        estimate, ahead = (run.call(partial(_elements, mode.own), x) for x in (estimate, ahead))
        if mode.compensated:
            ahead, push = run.call(
                partial(_balanced, mode.compensated), ahead, loads, data.balance_state, data.balance_input
            )
    requested, held = r, memory.reference
    if mode.changes_command:
        held = memory.command
    boxed, stop = [source.state for source in tracked] if mode.moving else range(len(tracked)), []
    if mode.reacts:
        position = r
        if "hold" in mode.reactions and mode.moving:
            position = run.call(partial(standing, tracked, mode.velocities), y, estimate, r)
        elif "hold" in mode.reactions:
            position = run.call(partial(positions, tracked), y, estimate)
        run.section(
            "Reactions: a command that leaves the workspace, and what lasts, hold the command or brake"
        )
        r, *stop = run.call(
            partial(reaction, boxed, mode.reactions), r, held, position, memory.started, memory.status, memory.stop,
            data.workspace, data.watching,
        )  # fmt: skip
    if mode.limits_command:
        r = run.call(
            partial(_limited, tracked), y, estimate, r, held, memory.started, data.period, data.command_lower,
            data.command_upper, data.command_rate,
        )  # fmt: skip
    kept, lag = dict[str, Any](), list[Any]()
    if mode.governed:
        run.section("Joints that are far from the command are shown one that brings them back slowly")
        r, *lag, kept = brought_back(run, tracked, mode, (y, estimate), r, means, memory, data, estimator)
    active: Any = None
    run.section("Tracked positions, their integrals, and the law's argument")
    point, operating_input, relief = data.operating_point, data.operating_input, data.integral_relief
    taken, inverse = None, data.inverse_slope if mode.takes_over else None
    lines = [data.integral_gain, data.windup_line, data.windup_spread] if mode.bounds_windup else []
    if mode.laws > 1:
        places = [source.state for source in tracked]
        active, taken, point, operating_input, relief, inverse, *lines = chosen_law(
            run, places, mode, r, memory.active, memory.started, data
        )
    elif mode.takes_over:
        taken = run.call(partial(np.subtract, 1.0), memory.started)  # 1 at the first sample, else 0
    operating_input = r[len(estimate) :] if mode.moving else operating_input
    operating_input = operating_input if push is None else run.call(np.add, operating_input, push)
    if mode.speeds:
        operating_input = run.call(partial(overcoming, mode.speeds), operating_input, r, data.dry_friction)
    wanted, commands = r, None
    if mode.command_lead:
        commands, wanted, held = run.call(_passed, memory.started, r, held, memory.commands)
    commanded = requested if mode.governed else wanted
    others = (
        *((r, wanted) if mode.moving else ()),
        *((data.integral_dead_zone,) if mode.has_dead_zone else ()),
        *lag,
    )
    position, integral, deviation = run.call(
        partial(_deviation, tracked, mode.moving, mode.governed), y, estimate, ahead, memory.position, held,
        memory.integral, memory.started, data.period, point, *others,
    )  # fmt: skip
    about: Any = None
    if mode.moving and law.law.depends_on_reference:
        # In memory of its own: loops inside a sample may read it.
        about = run.call(partial(_state_and_input, len(estimate)), r)
    run.section("The law u = k(x - x*)" if about is None else "The law about the moving reference")
    law_of = law.on(run, data.law, active, about)
    feedback = law_of(deviation)
    after = {"position": position, "reference": requested, "command": r, "active": active}
    after |= {"queue": queue, "commands": commands, "doubt": doubt, "readings": seen, **kept}
    if mode.takes_over:
        run.section(
            "Where a law takes over: integrals that continue the last input, by Broyden's method, and a bias that fades"
        )
        wanted = run.call(_wanted, memory.u, operating_input)
        feedback, integral, after["bias"] = bumpless_transfer(
            run, law_of, taken, deviation, feedback, wanted, inverse, memory.bias, point, data.decay
        )
    if mode.eases:
        feedback, after["ease"] = run.call(
            eased, feedback, operating_input, memory.u, memory.ease, memory.stop, *stop, memory.status, data.watching
        )  # fmt: skip
    rates, bounds = (memory.u, data.period, data.input_rate) if mode.limits_input_rate else (), ()
    if mode.bounds_windup:
        places = None if mode.moving else [source.state for source in tracked]
        bounds = (run.call(partial(_wound, places), integral, point, r, *lines, data.windup_limit),)
    run.section("The input within its limits; integrals do not wind up")
    after |= {"offset": offset[0], "offset_known": offset[1], "stop": stop[0] if stop else None}
    after["u"], after["integral"], after["started"] = run.call(
        partial(_limited_input, mode.bounds_windup), feedback, integral, operating_input, data.lower, data.upper,
        relief, *bounds, *rates,
    )  # fmt: skip
    u = after["u"]
    if mode.reactions:
        run.section("What is watched, and the status")
        y = y if gap is None else run.call(np.subtract, y, gap)
        if mode.has_offset:
            position = run.call(partial(as_measured, tracked), y, offset[0], estimate)
        elif gap is not None:
            position = run.call(partial(positions, tracked), y, estimate)
        marks = [kept[name] for name in ("far", "hold") if name in kept]
        after["watch"], after["status"] = run.call(
            partial(observed, boxed, mode.reactions, len(marks)), u, requested, memory.reference, position, commanded,
            memory.started, memory.watch, data.lower, data.upper, data.workspace, data.swings, data.watching,
            data.following, *marks, *stop,
        )  # fmt: skip
    if mode.protected is not None and seen is not None and expected is not None:
        run.section("Signs of a robot that does not move as one within its tolerances")
        places = Seen(read, expected, seen, turns, acted, u, position, commanded, kept.get("hold"))
        flags, own = signs(run, mode.protected, boxed, places, memory, data)
        after |= own
        after["status"] = run.call(_status, after["status"], repeated, flags)
    if estimator is not None:
        if mode.speeds and not beliefs:
            u = run.call(partial(modelled, mode.speeds), u, r, data.dry_friction)
        after["belief"] = (beliefs or predict_ahead(run, estimator, belief, [u], data))[0]
    return after["u"], whole, after


def _elements(places: Sequence[int], x: Any) -> Any:
    return np.asarray(x)[list(places)]


@gives("status_next")
def _status(watched: Any, repeated: Any, flags: Any) -> Any:
    return np.concatenate([watched, repeated, flags])


def _balanced(places: Sequence[int], ahead: Any, whole: Any, state: Any, push: Any) -> tuple[Any, Any]:
    """The law's states less what the loads move their equilibrium by, and the input that balances the loads."""
    loads = _elements(places, whole)
    return ahead - state @ loads, push @ loads


def predict_ahead(run: Any, estimator: Estimator, belief: Any, inputs: Sequence[Any], data: Any) -> list[Any]:
    """x(k+1|k), x(k+2|k), …: the estimator's beliefs after each of the inputs (m,), in the order in which they act."""
    beliefs = [belief]
    for u in inputs:
        beliefs.append(estimator.time_update_on(run, beliefs[-1], u, data.parameters, data.process_noise))
    return beliefs[1:]


@gives("queue_next", "*waiting", "acted")
def _waiting(last: Any, queue: Any) -> tuple[Any, ...]:
    """The next queue (N, m), and all inputs that were computed, newest first: N that wait, and the one that acted until
    this sample."""
    rows = [last, *queue]
    return np.stack(rows[:-1]), *rows


@gives("*command_before")
def _rows(commands: Any) -> tuple[Any, ...]:
    return tuple(commands)


@gives("commands_next", "wanted", "held")
def _passed(started: Any, r: Any, last: Any, queue: Any) -> tuple[Any, Any, Any]:
    """The next queue of commands, and those for this sample and the one before; the first command holds before it."""
    rows = [where(started[0] > 0.5, row, r) for row in (last, *queue)]
    return np.stack(rows[:-1]), *rows[-2:]


@gives("position", "integral", "deviation")
def _deviation(
    tracked: Sequence[Source],
    moving: bool,
    governed: Sequence[Sequence[int]],
    y: Any,
    estimate: Any,
    ahead: Any,
    last: Any,
    reference: Any,
    integral: Any,
    started: Any,
    period: Any,
    point: Any,
    *others: Any,
) -> tuple[Any, Any, Any]:
    """Tracked positions, integrals, and the law's argument: x − x*, or x − x_d about the moving reference, where x is
    the state `ahead`, at which the input acts."""
    n, places = len(estimate), [source.state for source in tracked]
    share: Any = ()
    position = positions(tracked, y, estimate)
    if moving:
        # ė = x_i − x_di, both of which move between samples: the error goes in by the trapezoidal rule.
        error = 0.5 * ((last - reference[places]) + (position - others[1][places]))
    else:
        # ė = x_i − x_d: the command is held between samples, as u is; x_i goes in by the trapezoidal rule.
        error = 0.5 * (last + position) - reference
    if governed:
        (lag, faster, share), others = others[-1], others[:-1]
        error, integral = unwound(error, integral, lag), braked(integral, faster, period)
    # What lies beyond the dead zone ±zone (k,), where there is one.
    for zone in others[2:] if moving else others:
        error = error - clip(error, -zone, zone)
    integral = integral + where(started[0] > 0.5, period * error, 0.0)
    centre = np.concatenate([others[0][:n], point[n:]]) if moving else point
    deviation = np.concatenate([np.asarray(ahead), integral]) - centre
    return position, integral, believed(governed, share, deviation) if governed else deviation


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
    last = where(started[0] > 0.5, last, positions(tracked, y, estimate))
    return clip(clip(r, lower, upper), last - period * rate, last + period * rate)


def _wound(
    places: Sequence[int] | None,
    integral: Any,
    point: Any,
    r: Any,
    gain: Any,
    line: Any,
    spread: Any,
    limit: Any,
) -> Any:
    """Integral action (m,) beyond its bound, see `flexhinf.loop.controller.options`; about a moving reference, which
    has no `places`, the law needs none of it at rest."""
    pushed = gain @ (integral - point[len(point) - len(integral) :])
    if places is not None:
        away = r - point[places]
        pushed, limit = pushed - line @ away, limit + spread @ absolute(away)
    return pushed - clip(pushed, -limit, limit)


@gives("u_next", "integral_next", "started_next")
def _limited_input(
    bounded: bool,
    feedback: Any,
    integral: Any,
    operating_input: Any,
    lower: Any,
    upper: Any,
    relief: Any,
    *bounds: Any,
) -> tuple[Any, Any, Any]:
    """The input within its limits, the integrals after anti-windup, and the flag that a step was made.

    The last of the arguments are, where windup is `bounded`, the integral action beyond its bound; and the last input,
    the period and the largest rate, where that is limited.
    """
    wanted = operating_input + feedback
    u = clip(wanted, lower, upper)
    if rates := bounds[1:] if bounded else bounds:
        last, period, rate = rates
        u = clip(u, last - period * rate, last + period * rate)
    excess = wanted - u + bounds[0] if bounded else wanted - u
    # Anti-windup by back-calculation. A wild estimate makes 1e18 V, which would be the integrals' for long.
    most = WILD * (upper - lower)
    return u, integral - relief @ clip(excess, -most, most), np.ones(1)


#: Fraction of an input's excess that is taken back of its integral per sample. With 0.05, four joints with motors of a
#: third of their torque swung for 5 s about their goal; more is hardly better, and hears more of an input's noise.
RELIEF = 0.2

#: Excess of an input, in units of its range, of which no more is taken back. An error of a radian makes some 70.
WILD = 100.0

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


def _state_and_input(states: int, r: Any) -> tuple[Any, Any]:
    return r[:states], r[states:]


@gives("wanted")
def _wanted(last: Any, operating: Any) -> Any:
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


def chosen_law(
    run: Any, places: Sequence[int], mode: StepMode, r: Any, active: Any, started: Any, data: Any
) -> tuple[Any, ...]:
    """Which law is active at this sample, and its numbers.

    The command r is (k,), or (n + m,) of a moving reference; `places` are those of the tracked states among all states,
    `active` (L,) is 1 for the law that was active, `started` (1,) 0 at the first sample, before which none was.

    Returns what is active now (L,); 1 where a law takes over (1,); and of the active law operating point and input,
    relief of the integrals and inverse slope, and where windup is bounded integral_gain, windup_line and windup_spread.
    """
    tables = (data.operating_point, data.operating_input, data.integral_relief, data.inverse_slope)
    tables += (data.integral_gain, data.windup_line, data.windup_spread) if mode.bounds_windup else ()

    def choose(r: Any, active: Any, started: Any, closer: Any, points: Any, *tables: Any) -> tuple[Any, ...]:
        apart = points[:, places] - (r[places] if mode.moving else r)
        distances = (apart * apart).sum(axis=1)
        nearest, index = distances[0], 0.0
        for law, distance in enumerate(distances[1:], 1):
            index = where(distance < nearest, float(law), index)
            nearest = where(distance < nearest, distance, nearest)
        # Squared distances, so squared fractions; the first sample chooses without hysteresis.
        changes = where(started[0] > 0.5, nearest < closer[0] * closer[0] * (active @ distances), True)
        now = np.array([where(changes, where(index == law, 1.0, 0.0), was) for law, was in enumerate(active)])
        taken = where(started[0] > 0.5, 1.0 - active @ now, 1.0 if mode.start == "bumpless" else 0.0)
        return now, np.array([taken]), *(np.tensordot(now, table, axes=1) for table in (points, *tables))

    return run.call(choose, r, active, started, data.closer, *tables)
