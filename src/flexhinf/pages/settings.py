"""Every assumption and setting of a result, each with who states it: robot, synthesis, estimator, loop and runs."""

from __future__ import annotations

import re

import numpy as np

from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.loop_setup import INITIAL_VARIANCE, LoopPlants
from flexhinf.designs.responses import ROBOT
from flexhinf.designs.specification import FIELDS, Specification
from flexhinf.designs.synthesis.steps import Synthesis
from flexhinf.estimation import MODEL_STEP
from flexhinf.numerals import number, power_of
from flexhinf.pages.design.weights import effort_unit, state_weights
from flexhinf.pages.drawing import Units, listed, units_of
from flexhinf.report import Fact
from flexhinf.robot import Robot
from flexhinf.robot.springs import SPRING_DAMPING

#: In the name of a move: its ends, which are in other rows, in the units of the page.
_ENDS = re.compile(r" from \([^()]*\) to \([^()]*\) (?=in )")


def design_settings(synthesis: Synthesis, e: LawEvaluation, region: bool = True) -> dict[str, list[Fact]]:
    """Settings of a design in groups, in the order in which the design uses them; of its `region` too."""
    return {
        "Robot": robot_rows(e.setup.true.robot),
        "Synthesis": _synthesis(synthesis, e, region),
        "Estimator": _estimator(e),
        "Simulation": _simulation(e),
    }


def damping_text(robot: Robot) -> str:
    """With which damping of its springs the robot is judged."""
    assumed, elastic = robot.assumed_damping, [name for name in robot.joint_names if name not in robot.rigid]
    stated = [name for name in elastic if name not in assumed]
    if not assumed:
        return "Springs are damped as the file states."
    share = f"{100.0 * SPRING_DAMPING:g} %"
    beside = f"; that of {listed(stated)} is stated" if stated else ""
    return (
        f"Springs are assumed to be damped by {share} of their own vibration, since the file states no damping of "
        f"{listed(list(assumed))}{beside}."
    )


def robot_rows(robot: Robot) -> list[Fact]:
    """Settings: the joints and every number of a robot with its tolerance."""
    spreads = {p.name: f" ({p.spread})" if p.range is not None else f" {p.spread}" for p in robot.parameters}
    for dry, wet in robot.dry_by_viscous.items():
        spreads[dry] = f"{spreads[wet]} with its viscous friction" if spreads[wet].strip() else ""
    return [
        Fact("joints", list(robot.joint_names), "", robot.name),
        *(
            Fact(
                name.replace("_", " "),
                f"{number(p.value, 6)}{spreads[name]}".rstrip(),
                "" if p.unit == "1" else p.unit,
                p.source,
            )
            for name, p in ((p.name, p) for p in robot.parameters)
        ),
    ]


def sensor_rows(setup: LoopPlants) -> list[Fact]:
    """Settings: what is measured, and with which noise."""
    plant, source = setup.model, source_of(setup.specification, "measurement_noise")
    return [
        Fact("measured", list(plant.outputs), "", source_of(setup.specification, "measured")),
        *(
            Fact(f"Rⁿ of {name.replace('_', ' ')}", float(value), power_of(plant.unit(name), "²"), source)
            for name, value in zip(plant.outputs, setup.noise_variances)
        ),
        Fact("simulated noise", "white, of these variances", "", "ours"),
    ]


def loop_rows(setup: LoopPlants) -> list[Fact]:
    """Settings: when an input acts, and the limits of the joints."""
    s, limits, units = setup.specification, setup.limits, Units(setup.model, setup.joints)
    bounds = (
        np.broadcast_to(np.inf if limits.saturated is None else limits.saturated, limits.speed.shape),
        limits.speed,
    )
    peaked = not np.array_equal(bounds[0], limits.saturation)
    sources = limits.peak_source if peaked else limits.saturation_source, limits.speed_source
    inputs = units.effort_text(bounds[0]) if np.isfinite(bounds[0]).any() else "none"
    speeds = units.each_text(bounds[1], units.speed, "±") if limits.limits_speed else "none"
    stated = [source if source == ROBOT else f"option {source}" for source in sources]
    quanta = [0.0] if setup.quantisation is None else np.atleast_1d(setup.quantisation).tolist()
    return [
        Fact("sampling period", s.period, "s", source_of(s, "period")),
        Fact(
            "latency, known to the estimator",
            s.known_latency,
            f"sample{'s' * (s.known_latency != 1)}",
            source_of(s, "latency"),
        ),
        Fact("delay of the inputs on top of it", s.unknown_delay, "s", source_of(s, "unknown_delay")),
        Fact(
            "quantisation of the measurements",
            quanta[0] if len(set(quanta)) == 1 else quanta,
            "",
            source_of(s, "quantisation"),
        ),
        Fact("limits of the inputs", inputs, "", stated[0]),
        Fact("limits of the speeds", speeds, "", stated[1]),
        *(
            Fact(f"limits of the inputs' {name}s", units.effort_text(most), f"per {time}", ROBOT)
            for name, most, time in (("rate", limits.rate, "s"), ("acceleration", limits.acceleration, "s²"))
            if np.isfinite(most).any()
        ),
    ]


def source_of(s: Specification, name: str, otherwise: str = "") -> str:
    """Who states a field: an option, our default, or `otherwise` where it is None."""
    value = getattr(s, name)
    if otherwise and value is None:
        return otherwise
    default = not otherwise and value == getattr(Specification(), name)
    return f"{'default of' if default else 'option'} {FIELDS[name].switch}"


def _synthesis(synthesis: Synthesis, e: LawEvaluation, region: bool) -> list[Fact]:
    s, problem, chosen = e.setup.specification, synthesis.problem, synthesis.design_problem
    proved, degrees = synthesis.proved, [c.degree for c in synthesis.choices]
    counted, last = "for the number of states", list[Fact]()
    if region and proved is None:
        checked = "0.9 × the designed one" if s.checked_penalty is None else str(s.checked_penalty)
        last = [
            Fact("checked γ/γ*", s.checked_gamma_ratio, "", source_of(s, "checked_gamma_ratio")),
            Fact("checked penalty", checked, "", source_of(s, "checked_penalty")),
            Fact("rays", synthesis.rays, "", source_of(s, "rays", counted)),
        ]
    if proved is not None:
        source = source_of(s, "checked_penalty", "the robot's own, or Eq. (11)")
        last = [
            Fact("γ that is proved", proved.gamma, "", "searched"),
            Fact("penalty whose gain is proved", str(proved.problem.penalty.states), "", source),
            Fact("R2 of that penalty", proved.problem.r2, "", source),
        ]
    return [
        Fact("preset", chosen.preset, "", "option --preset" if s.preset else "by what is required"),
        Fact("pose", *_positions(e, synthesis.goal), source_of(s, "pose")),
        *(
            Fact(f"weight of {name.replace('_', ' ')}", weight, unit, chosen.source)
            for name, weight, unit in state_weights(problem, e.setup.joints)
        ),
        Fact("R2", np.asarray(problem.penalty.effort), effort_unit(problem), chosen.effort_source),
        Fact("disturbances", list(problem.disturbance_names), "", source_of(s, "disturbances")),
        Fact("integrated errors", list(problem.integrate), "", "ours"),
        Fact("γ* of the problem", chosen.gamma_star, "", "bisection, relative 1e-8"),
        Fact(
            "γ/γ*",
            chosen.gamma / chosen.gamma_star,
            "",
            "searched" if proved else source_of(s, "gamma_ratio"),
        ),
        Fact("degrees of V tried", degrees, "", "option --degrees" if s.degrees else counted),
        Fact(
            "degree of V", synthesis.chosen.degree, "", "by the cost of the step" if len(degrees) > 1 else ""
        ),
        *last,
    ]


def _positions(e: LawEvaluation, values: np.ndarray) -> tuple[np.ndarray, str]:
    """Link positions and their unit, as the page shows them."""
    units = units_of(e)
    own = [units.of(units.angle, joint) for joint in units.joints]
    return units.scale * values, ", ".join(own[:1] if len(set(own)) == 1 else own)


def _estimator(e: LawEvaluation) -> list[Fact]:
    s, noise = e.setup.specification, e.setup.process_noise
    own: list[Fact] = [Fact("estimator", s.estimator, "", source_of(s, "estimator"))]
    if s.estimator == "none":
        return [*own, Fact("fed back", "the true state", "", "option --estimator none")]
    links, motors = (
        list(levels) if isinstance(levels, tuple) else levels
        for levels in (noise.link_velocities, noise.motor_velocities)
    )
    initial = "stationary covariance of the filter in equilibrium at the goal"
    return [
        *own,
        *sensor_rows(e.setup),
        Fact("Rᵛ on every state", noise.all_states, "per sample", noise.source),
        Fact("Rᵛ on link velocities, added", links, "per sample", noise.source),
        Fact("Rᵛ on motor velocities, added", motors, "per sample", noise.source),
        Fact("initial estimate", "the equilibrium at the start of the run", "", "ours"),
        Fact("P0", initial if noise.largest else f"{INITIAL_VARIANCE:g} I", "", "ours"),
        Fact("model", "the nominal robot without extras", "", "ours"),
        *([Fact("α, β, κ", "1, 2, 0", "", "Table 3 of Elsa & Akbari 2014")] if s.estimator == "ukf" else []),
    ]


def _simulation(e: LawEvaluation) -> list[Fact]:
    s, runs, filter, zone = e.setup.specification, e.scenario, e.loop.filter, e.setup.dead_zone
    size, unit = ("none", "") if zone is None else _positions(e, zone)
    assert runs is not None
    extras = f", with {', '.join(e.setup.extras)}" if e.setup.extras else ", no extras"
    steps, seed = "Runge–Kutta steps per period", f"uniform within the tolerances, seed ({s.seed}, 7)"
    rows: list[Fact] = [
        Fact(
            "start pose",
            *_positions(e, e.setup.start),
            source_of(s, "start", "ours: 0.1 rad (10 mm) from the goal"),
        ),
        Fact(
            "command",
            "the goal, from the first sample on" if e.setup.command is None else e.setup.command.name,
            "",
            source_of(s, "shaping"),
        ),
        Fact("move", _ENDS.sub(" ", runs.plan.name), "", source_of(s, "move", "ours: the way of the step")),
        Fact("true plant", f"nominal numbers{extras}", "", source_of(s, "extras")),
        Fact(
            "extras that the linear loop leaves out",
            list(e.setup.left_out) or "none",
            "",
            "ours: their slope at standstill holds only for the smallest velocities",
        ),
        *loop_rows(e.setup),
        Fact(
            "dead zone of the integrals",
            size,
            unit,
            source_of(s, "integral_dead_zone", "ours: against limit cycles"),
        ),
        Fact(
            "length of the step",
            runs.step_duration,
            "s",
            source_of(s, "duration", "by the slowest mode, 0.5 to 20 s"),
        ),
        Fact(
            "load",
            runs.load,
            e.setup.model.unit(e.setup.model.disturbances[0]),
            source_of(s, "load", "a tenth of what the motors give at the peak of the step"),
        ),
        Fact("sampled robots", len(runs.robots), "", seed),
        Fact(steps, runs.sub_steps, "", "true plant: step × fastest mode ≤ 0.01"),
    ]
    if filter is not None:
        most = f"{filter.stages} stages, step × fastest mode ≤ {MODEL_STEP[filter.stages]}"
        rows.append(Fact(steps, filter.sub_steps, "", f"estimator's model: {most}"))
    return rows
