"""What ends a page: every setting with who states it, every number of the robot with its source, and the files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePath
from typing import Any

import numpy as np

from flexhinf.design.estimators import INITIAL_VARIANCE, EstimatorNoise, Levels, noise_variances
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.joint_limits import ROBOT
from flexhinf.design.result import Comparison, Design
from flexhinf.design.specification import Specification
from flexhinf.design.synthesis.steps import Synthesis
from flexhinf.estimation import MODEL_STEP
from flexhinf.pages.design.weights import effort_unit, state_weights
from flexhinf.pages.drawing import limit_text, units_of
from flexhinf.report import Section, Setting, Table
from flexhinf.robot import Robot
from flexhinf.robot.signals import signal_names

#: What a file is, by its name or its ending; the first that fits.
MEANING = (
    ("design.toml", "the request and its result; `flexhinf design design.toml` makes the design again"),
    ("design.json", "every number of this page"),
    ("comparison.json", "every number of this page"),
    ("controller.json", "the controller: `flexhinf.load_controller`"),
    ("controller", "the controller: `flexhinf.load_controller`"),
    (".csv", "one run, one column for each signal, SI units, time in s"),
    (".nc", "one run as NetCDF: `xarray.open_dataset`, units as attributes"),
)


def design_settings(design: Design) -> dict[str, list[Setting]]:
    """In the order of the work."""
    return _groups(design.synthesis, design.evaluation)


def comparison_settings(comparison: Comparison) -> dict[str, list[Setting]]:
    """The comparison first, then the design's own law."""
    own = comparison.own.evaluation
    assert own is not None
    return {"Comparison": _comparison(comparison, own), **_groups(comparison.synthesis, own)}


def _groups(synthesis: Synthesis, e: LawEvaluation) -> dict[str, list[Setting]]:
    return {
        "Robot": _robot(e.setup.robot),
        "Synthesis": _synthesis(synthesis, e),
        "Estimator": _estimator(e),
        "Simulation": _simulation(e),
    }


def _robot(robot: Robot) -> list[Setting]:
    rows = [Setting("joints", list(robot.joint_names), "", robot.name)]
    for p in robot.parameters:
        spread = f" ({p.spread})" if p.range is not None else f" {p.spread}"
        rows.append(Setting(p.name.replace("_", " "), f"{p.value:g}{spread}".rstrip(), p.unit, p.source))
    return rows


def _option(s: Specification, name: str) -> str:
    """Whether a field has its default."""
    same = getattr(s, name) == getattr(Specification(), name)
    return f"{'default of' if same else 'option'} --{name.replace('_', '-')}"


def _synthesis(synthesis: Synthesis, e: LawEvaluation) -> list[Setting]:
    s, problem, chosen, proved = (
        e.setup.specification,
        synthesis.problem,
        synthesis.design_problem,
        synthesis.proved,
    )
    counted = "for the number of states"
    rows = [
        ("preset", chosen.preset, "", "option --preset" if s.preset else "by what is required"),
        (
            "pose",
            synthesis.goal,
            _units(e),
            "option --pose"
            if s.pose is not None
            else "the robot's home"
            if s.move is None
            else "the last waypoint of --move",
        ),
        *(
            (f"weight of {w.signal.replace('_', ' ')}", w.value, w.unit, chosen.source)
            for w in state_weights(problem, e.setup.joints)
        ),
        ("R2", np.asarray(problem.penalty.effort), effort_unit(problem), chosen.effort_source),
        ("disturbances", list(problem.disturbance_names), "", _option(s, "disturbances")),
        ("integrated errors", list(problem.integrate), "", "ours"),
        ("γ* of the problem", chosen.gamma_star, "", "bisection, relative 1e-8"),
        (
            "γ/γ*",
            chosen.gamma / chosen.gamma_star,
            "",
            _option(s, "gamma_ratio") if proved is None else "searched",
        ),
        (
            "degrees of V tried",
            [c.degree for c in synthesis.choices],
            "",
            "option --degrees" if s.degrees else counted,
        ),
        (
            "degree of V",
            synthesis.chosen.degree,
            "",
            "by the cost of the step" if len(synthesis.choices) > 1 else "",
        ),
    ]
    if proved is None:
        rows += [
            ("checked γ/γ*", s.checked_gamma_ratio, "", _option(s, "checked_gamma_ratio")),
            ("checked penalty", _checked(s), "", _option(s, "checked_penalty")),
            ("rays", synthesis.rays, "", counted if s.rays is None else "option --rays"),
        ]
    else:
        source = (
            "option --checked-penalty" if s.checked_penalty is not None else "the robot's own, or Eq. (11)"
        )
        rows += [
            ("γ that is proved", proved.gamma, "", "searched"),
            ("penalty whose gain is proved", str(proved.problem.penalty.states), "", source),
            ("R2 of that penalty", proved.problem.r2, "", source),
        ]
    return [Setting(*row) for row in rows]


def _units(e: LawEvaluation) -> str:
    """The unit of link positions, or that of each joint where they differ."""
    units = [e.setup.model.unit(name) for name in signal_names("link_position", e.setup.joints)]
    return units[0] if len(set(units)) == 1 else ", ".join(units)


def _checked(s: Specification) -> Any:
    return "0.9 × the designed one" if s.checked_penalty is None else str(s.checked_penalty)


def _estimator(e: LawEvaluation) -> list[Setting]:
    s, plant, noise = e.setup.specification, e.setup.model, e.setup.process_noise
    rows = [Setting("estimator", s.estimator, "", _option(s, "estimator"))]
    if s.estimator == "none":
        return [*rows, Setting("fed back", "the true state", "", "option --estimator none")]
    rows.append(Setting("measured", list(plant.outputs), "", _option(s, "measured")))
    for name, variance in zip(plant.outputs, noise_variances(plant, s.measurement_noise)):
        unit = f"({plant.unit(name)})²"
        rows.append(
            Setting(f"Rⁿ of {name.replace('_', ' ')}", float(variance), unit, _option(s, "measurement_noise"))
        )
    return [
        *rows,
        Setting("simulated noise", "white, of these variances", "", "ours"),
        Setting("Rᵛ on every state", noise.all_states, "per sample", noise.source),
        Setting("Rᵛ on link velocities, added", _each(noise.link_velocities), "per sample", noise.source),
        Setting("Rᵛ on motor velocities, added", _each(noise.motor_velocities), "per sample", noise.source),
        Setting("initial estimate", "the equilibrium at the start of the run", "", "ours"),
        Setting("P0", _initial(noise), "", "ours"),
        Setting("model", "the nominal robot without extras", "", "ours"),
        *(
            [Setting("α, β, κ", "1, 2, 0", "", "Table 3 of Elsa & Akbari 2014")]
            if s.estimator == "ukf"
            else []
        ),
    ]


def _each(levels: Levels) -> Any:
    return list(levels) if isinstance(levels, tuple) else levels


def _initial(noise: EstimatorNoise) -> str:
    if not noise.largest:
        return f"{INITIAL_VARIANCE:g} I"
    return "stationary covariance of the filter in equilibrium at the goal"


def _simulation(e: LawEvaluation) -> list[Setting]:
    s, runs, filter = e.setup.specification, e.scenario, e.loop.filter
    assert runs is not None
    extras = f", with {', '.join(s.extras)}" if s.extras else ", no extras"
    limits = e.setup.limits
    inputs, speeds = (
        limit_text(one) if np.isfinite(one).any() else "none" for one in (limits.saturation, limits.speed)
    )
    quanta = [0.0] if e.setup.quantisation is None else np.atleast_1d(e.setup.quantisation).tolist()
    steps, seed = "Runge–Kutta steps per period", f"uniform within the tolerances, seed ({s.seed}, 7)"
    rows = [
        ("start pose", e.setup.start, _units(e),
         "ours: 0.1 rad (10 mm) from the goal" if s.start is None else "option --start"),
        ("command", "the goal, from the first sample on" if e.setup.command is None else e.setup.command.name, "",
         _option(s, "shaping")),
        ("move", runs.plan.name, "", "ours: the way of the step" if s.move is None else "option --move"),
        ("true plant", f"nominal numbers{extras}", "", _option(s, "extras")),
        ("extras that the linear loop leaves out", list(e.setup.left_out) or "none", "",
         "ours: their slope at standstill holds only for the smallest velocities"),
        ("sampling period", s.period, "s", _option(s, "period")),
        ("delay of the inputs", s.delay, "s", _option(s, "delay")),
        ("quantisation of the measurements", quanta[0] if len(set(quanta)) == 1 else quanta, "",
         _option(s, "quantisation")),
        ("dead zone of the integrals", "none" if e.setup.dead_zone is None else e.setup.dead_zone, _units(e),
         "ours: against hunting" if s.integral_dead_zone is None else "option --integral-dead-zone"),
        ("limits of the inputs", inputs, units_of(e).effort if limits.saturated is not None else "",
         _stated(limits.saturation_source)),
        ("limits of the speeds", speeds, units_of(e).speed if limits.limits_speed else "",
         _stated(limits.speed_source)),
        ("length of the step", runs.step_duration, "s",
         "by the slowest mode, 0.5 to 20 s" if s.duration is None else "option --duration"),
        ("load", runs.load, e.setup.model.unit(e.setup.model.disturbances[0]),
         "a tenth of what the motors give at the peak of the step" if s.load is None else "option --load"),
        ("sampled robots", len(runs.robots), "", seed),
        (steps, runs.sub_steps, "", "true plant: step × fastest mode ≤ 0.01"),
    ]  # fmt: skip
    if filter is not None:
        most = f"{filter.stages} stages, step × fastest mode ≤ {MODEL_STEP[filter.stages]}"
        rows.append((steps, filter.sub_steps, "", f"estimator's model: {most}"))
    return [Setting(*row) for row in rows]


def _stated(source: str) -> str:
    return source if source == ROBOT else f"option {source}"


def _comparison(comparison: Comparison, own: LawEvaluation) -> list[Setting]:
    runs, criterion = own.scenario, comparison.criterion
    assert runs is not None
    return [
        Setting("laws", [row.name for row in comparison.rows], "", "option --laws, or the default"),
        Setting("tuned for", criterion.text, "", "ours"),
        *(
            Setting(limit.label, f"{'≥' if limit.least else '≤'} {limit.value:.4g}", limit.unit, limit.origin)
            for limit in criterion.limits
        ),
        Setting("shared limit", criterion.mode, "", "option --tune"),
        Setting("measurement noise", "of the sampled robots only, not of the nominal one", "", "ours"),
        Setting("command", "the whole step at once, integrals at zero, for every law", "", "ours"),
        Setting(
            "load begins at", "a tenth of its run", "", f"{runs.load_duration:g} s long, in equilibrium at the goal"
        ),
        Setting("plan of the move", float(runs.plan.duration), "s", "the same for every law"),
        Setting("sensors", "those of the design or of the law's proponents", "", "see the table of laws"),
    ]  # fmt: skip


def files_section(files: Sequence[str]) -> Section:
    """One row for each file; those of one folder that mean the same share a row."""
    grouped: dict[tuple[str, str], list[str]] = {}
    for name in sorted(files):
        folder, _, file = name.rpartition("/")
        grouped.setdefault((folder, _meaning(name)), []).append(file)
    rows = [
        (
            ", ".join(f"`{f'{folder}/' if folder and k == 0 else ''}{file}`" for k, file in enumerate(names)),
            meaning,
        )
        for (folder, meaning), names in grouped.items()
    ]
    return Section("Files beside this page", (Table(("file", "content"), rows, stacks=True),), "files")


def _meaning(name: str) -> str:
    for key, text in MEANING:
        if name == key or PurePath(name).suffix == key or PurePath(name).stem == key:
            return text
    return ""
