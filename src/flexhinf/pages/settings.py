"""What ends a page: every setting with who states it, every number of the robot with its source, and the files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePath
from typing import Any

import numpy as np

from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.joint_limits import ROBOT
from flexhinf.design.loop_setup import INITIAL_VARIANCE, noise_variances
from flexhinf.design.result import Comparison, Design
from flexhinf.design.specification import Specification
from flexhinf.design.synthesis.steps import Synthesis
from flexhinf.estimation import MODEL_STEP
from flexhinf.pages.design.weights import effort_unit, state_weights
from flexhinf.pages.drawing import limit_text, units_of
from flexhinf.report import Section, Setting, Table
from flexhinf.robot.signals import signal_names

#: Name, value, unit and source.
Rows = list[tuple[Any, ...]]

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
    own, criterion = comparison.own.evaluation, comparison.criterion
    assert own is not None
    runs = own.scenario
    assert runs is not None
    load_run = f"{runs.load_duration:g} s long, in equilibrium at the goal"
    rows = [
        ("laws", [row.name for row in comparison.rows], "", "option --laws, or the default"),
        ("tuned for", criterion.text, "", "ours"),
        *((x.label, f"{'≥' if x.least else '≤'} {x.value:.4g}", x.unit, x.origin) for x in criterion.limits),
        ("shared limit", criterion.mode, "", "option --tune"),
        ("measurement noise", "of the sampled robots only, not of the nominal one", "", "ours"),
        ("command", "the whole step at once, integrals at zero, for every law", "", "ours"),
        ("load begins at", "a tenth of its run", "", load_run),
        ("plan of the move", float(runs.plan.duration), "s", "the same for every law"),
        ("sensors", "those of the design or of the law's proponents", "", "see the table of laws"),
    ]
    return {"Comparison": [Setting(*row) for row in rows], **_groups(comparison.synthesis, own)}


def _groups(synthesis: Synthesis, e: LawEvaluation) -> dict[str, list[Setting]]:
    robot = e.setup.robot
    rows: Rows = [("joints", list(robot.joint_names), "", robot.name)]
    for p in robot.parameters:
        spread = f" ({p.spread})" if p.range is not None else f" {p.spread}"
        rows.append((p.name.replace("_", " "), f"{p.value:g}{spread}".rstrip(), p.unit, p.source))
    groups = {
        "Robot": rows,
        "Synthesis": _synthesis(synthesis, e),
        "Estimator": _estimator(e),
        "Simulation": _simulation(e),
    }
    return {name: [Setting(*row) for row in rows] for name, rows in groups.items()}


def _source(s: Specification, name: str, otherwise: str = "") -> str:
    """The option of a field; where it was not stated its default, or where the value comes from."""
    option = f"--{name.replace('_', '-')}"
    if otherwise:
        return otherwise if getattr(s, name) is None else f"option {option}"
    return f"{'default of' if getattr(s, name) == getattr(Specification(), name) else 'option'} {option}"


def _synthesis(synthesis: Synthesis, e: LawEvaluation) -> Rows:
    s, problem, chosen = e.setup.specification, synthesis.problem, synthesis.design_problem
    proved, counted, degrees = (
        synthesis.proved,
        "for the number of states",
        [c.degree for c in synthesis.choices],
    )
    home = "the robot's home" if s.move is None else "the last waypoint of --move"
    rows: Rows = [
        ("preset", chosen.preset, "", "option --preset" if s.preset else "by what is required"),
        ("pose", synthesis.goal, _position_unit(e), _source(s, "pose", home)),
        *(
            (f"weight of {w.signal.replace('_', ' ')}", w.value, w.unit, chosen.source)
            for w in state_weights(problem, e.setup.joints)
        ),
        ("R2", np.asarray(problem.penalty.effort), effort_unit(problem), chosen.effort_source),
        ("disturbances", list(problem.disturbance_names), "", _source(s, "disturbances")),
        ("integrated errors", list(problem.integrate), "", "ours"),
        ("γ* of the problem", chosen.gamma_star, "", "bisection, relative 1e-8"),
        ("γ/γ*", chosen.gamma / chosen.gamma_star, "", "searched" if proved else _source(s, "gamma_ratio")),
        ("degrees of V tried", degrees, "", "option --degrees" if s.degrees else counted),
        ("degree of V", synthesis.chosen.degree, "", "by the cost of the step" if len(degrees) > 1 else ""),
    ]
    if proved is None:
        checked = "0.9 × the designed one" if s.checked_penalty is None else str(s.checked_penalty)
        return [
            *rows,
            ("checked γ/γ*", s.checked_gamma_ratio, "", _source(s, "checked_gamma_ratio")),
            ("checked penalty", checked, "", _source(s, "checked_penalty")),
            ("rays", synthesis.rays, "", _source(s, "rays", counted)),
        ]
    source = _source(s, "checked_penalty", "the robot's own, or Eq. (11)")
    return [
        *rows,
        ("γ that is proved", proved.gamma, "", "searched"),
        ("penalty whose gain is proved", str(proved.problem.penalty.states), "", source),
        ("R2 of that penalty", proved.problem.r2, "", source),
    ]


def _position_unit(e: LawEvaluation) -> str:
    """The unit of link positions, or that of each joint where they differ."""
    units = [e.setup.model.unit(name) for name in signal_names("link_position", e.setup.joints)]
    return units[0] if len(set(units)) == 1 else ", ".join(units)


def _estimator(e: LawEvaluation) -> Rows:
    s, plant, noise = e.setup.specification, e.setup.model, e.setup.process_noise
    rows: Rows = [("estimator", s.estimator, "", _source(s, "estimator"))]
    if s.estimator == "none":
        return [*rows, ("fed back", "the true state", "", "option --estimator none")]
    rows.append(("measured", list(plant.outputs), "", _source(s, "measured")))
    for name, variance in zip(plant.outputs, noise_variances(plant, s.measurement_noise)):
        what, unit = f"Rⁿ of {name.replace('_', ' ')}", f"({plant.unit(name)})²"
        rows.append((what, float(variance), unit, _source(s, "measurement_noise")))
    both = (noise.link_velocities, noise.motor_velocities)
    links, motors = (list(levels) if isinstance(levels, tuple) else levels for levels in both)
    initial = "stationary covariance of the filter in equilibrium at the goal"
    return [
        *rows,
        ("simulated noise", "white, of these variances", "", "ours"),
        ("Rᵛ on every state", noise.all_states, "per sample", noise.source),
        ("Rᵛ on link velocities, added", links, "per sample", noise.source),
        ("Rᵛ on motor velocities, added", motors, "per sample", noise.source),
        ("initial estimate", "the equilibrium at the start of the run", "", "ours"),
        ("P0", initial if noise.largest else f"{INITIAL_VARIANCE:g} I", "", "ours"),
        ("model", "the nominal robot without extras", "", "ours"),
        *([("α, β, κ", "1, 2, 0", "", "Table 3 of Elsa & Akbari 2014")] if s.estimator == "ukf" else []),
    ]


def _simulation(e: LawEvaluation) -> Rows:
    s, runs, filter, limits = e.setup.specification, e.scenario, e.loop.filter, e.setup.limits
    assert runs is not None
    extras = f", with {', '.join(s.extras)}" if s.extras else ", no extras"
    bounds, sources = (limits.saturation, limits.speed), (limits.saturation_source, limits.speed_source)
    inputs, speeds = (limit_text(bound) if np.isfinite(bound).any() else "none" for bound in bounds)
    stated = [source if source == ROBOT else f"option {source}" for source in sources]
    quanta = [0.0] if e.setup.quantisation is None else np.atleast_1d(e.setup.quantisation).tolist()
    steps, seed = "Runge–Kutta steps per period", f"uniform within the tolerances, seed ({s.seed}, 7)"
    position, units = _position_unit(e), units_of(e)
    command = "the goal, from the first sample on" if e.setup.command is None else e.setup.command.name
    zone = "none" if e.setup.dead_zone is None else e.setup.dead_zone
    load_unit = e.setup.model.unit(e.setup.model.disturbances[0])
    rows: Rows = [
        ("start pose", e.setup.start, position, _source(s, "start", "ours: 0.1 rad (10 mm) from the goal")),
        ("command", command, "", _source(s, "shaping")),
        ("move", runs.plan.name, "", _source(s, "move", "ours: the way of the step")),
        ("true plant", f"nominal numbers{extras}", "", _source(s, "extras")),
        ("extras that the linear loop leaves out", list(e.setup.left_out) or "none", "",
         "ours: their slope at standstill holds only for the smallest velocities"),
        ("sampling period", s.period, "s", _source(s, "period")),
        ("delay of the inputs", s.delay, "s", _source(s, "delay")),
        ("quantisation of the measurements", quanta[0] if len(set(quanta)) == 1 else quanta, "",
         _source(s, "quantisation")),
        ("dead zone of the integrals", zone, position, _source(s, "integral_dead_zone", "ours: against hunting")),
        ("limits of the inputs", inputs, units.effort if limits.saturated is not None else "", stated[0]),
        ("limits of the speeds", speeds, units.speed if limits.limits_speed else "", stated[1]),
        ("length of the step", runs.step_duration, "s", _source(s, "duration", "by the slowest mode, 0.5 to 20 s")),
        ("load", runs.load, load_unit, _source(s, "load", "a tenth of what the motors give at the peak of the step")),
        ("sampled robots", len(runs.robots), "", seed),
        (steps, runs.sub_steps, "", "true plant: step × fastest mode ≤ 0.01"),
    ]  # fmt: skip
    if filter is not None:
        most = f"{filter.stages} stages, step × fastest mode ≤ {MODEL_STEP[filter.stages]}"
        rows.append((steps, filter.sub_steps, "", f"estimator's model: {most}"))
    return rows


def files_section(files: Sequence[str]) -> Section:
    """One row for each file; those of one folder that mean the same share a row."""
    grouped: dict[tuple[str, str], list[str]] = {}
    for name in sorted(files):
        path = PurePath(name)
        meanings = (text for key, text in MEANING if key in (name, path.suffix, path.stem))
        folder, _, file = name.rpartition("/")
        grouped.setdefault((folder, next(meanings, "")), []).append(file)
    rows = []
    for (folder, meaning), names in grouped.items():
        first = f"{folder}/" if folder else ""
        rows.append((", ".join(f"`{'' if k else first}{file}`" for k, file in enumerate(names)), meaning))
    return Section("Files beside this page", (Table(("file", "content"), rows, stacks=True),), "files")
