"""What ends a page: every setting with who states it, every number of the robot with its source, and the files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePath
from typing import Any

import numpy as np

from flexhinf.design.estimators import INITIAL_VARIANCE, noise_variances
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
    rows = [
        ("laws", [row.name for row in comparison.rows], "", "option --laws, or the default"),
        ("tuned for", criterion.text, "", "ours"),
        *((x.label, f"{'≥' if x.least else '≤'} {x.value:.4g}", x.unit, x.origin) for x in criterion.limits),
        ("shared limit", criterion.mode, "", "option --tune"),
        ("measurement noise", "of the sampled robots only, not of the nominal one", "", "ours"),
        ("command", "the whole step at once, integrals at zero, for every law", "", "ours"),
        (
            "load begins at",
            "a tenth of its run",
            "",
            f"{runs.load_duration:g} s long, in equilibrium at the goal",
        ),
        ("plan of the move", float(runs.plan.duration), "s", "the same for every law"),
        ("sensors", "those of the design or of the law's proponents", "", "see the table of laws"),
    ]
    return {"Comparison": [Setting(*row) for row in rows], **_groups(comparison.synthesis, own)}


def _groups(synthesis: Synthesis, e: LawEvaluation) -> dict[str, list[Setting]]:
    groups = {
        "Robot": _robot(e.setup.robot),
        "Synthesis": _synthesis(synthesis, e),
        "Estimator": _estimator(e),
        "Simulation": _simulation(e),
    }
    return {name: [Setting(*row) for row in rows] for name, rows in groups.items()}


def _robot(robot: Robot) -> Rows:
    rows: Rows = [("joints", list(robot.joint_names), "", robot.name)]
    for p in robot.parameters:
        spread = f" ({p.spread})" if p.range is not None else f" {p.spread}"
        rows.append((p.name.replace("_", " "), f"{p.value:g}{spread}".rstrip(), p.unit, p.source))
    return rows


def _option(s: Specification, name: str) -> str:
    """Whether a field has its default."""
    same = getattr(s, name) == getattr(Specification(), name)
    return f"{'default of' if same else 'option'} --{name.replace('_', '-')}"


def _unless(s: Specification, name: str, otherwise: str) -> str:
    """The option, or where a value comes from that the user did not state."""
    return otherwise if getattr(s, name) is None else f"option --{name.replace('_', '-')}"


def _synthesis(synthesis: Synthesis, e: LawEvaluation) -> Rows:
    s, problem, chosen = e.setup.specification, synthesis.problem, synthesis.design_problem
    proved, counted = synthesis.proved, "for the number of states"
    home = "the robot's home" if s.move is None else "the last waypoint of --move"
    rows: Rows = [
        ("preset", chosen.preset, "", "option --preset" if s.preset else "by what is required"),
        ("pose", synthesis.goal, _units(e), _unless(s, "pose", home)),
        *(
            (f"weight of {w.signal.replace('_', ' ')}", w.value, w.unit, chosen.source)
            for w in state_weights(problem, e.setup.joints)
        ),
        ("R2", np.asarray(problem.penalty.effort), effort_unit(problem), chosen.effort_source),
        ("disturbances", list(problem.disturbance_names), "", _option(s, "disturbances")),
        ("integrated errors", list(problem.integrate), "", "ours"),
        ("γ* of the problem", chosen.gamma_star, "", "bisection, relative 1e-8"),
        ("γ/γ*", chosen.gamma / chosen.gamma_star, "", "searched" if proved else _option(s, "gamma_ratio")),
        (
            "degrees of V tried", [c.degree for c in synthesis.choices], "",
            "option --degrees" if s.degrees else counted,
        ),
        (
            "degree of V", synthesis.chosen.degree, "",
            "by the cost of the step" if len(synthesis.choices) > 1 else "",
        ),
    ]  # fmt: skip
    if proved is None:
        checked = "0.9 × the designed one" if s.checked_penalty is None else str(s.checked_penalty)
        return [
            *rows,
            ("checked γ/γ*", s.checked_gamma_ratio, "", _option(s, "checked_gamma_ratio")),
            ("checked penalty", checked, "", _option(s, "checked_penalty")),
            ("rays", synthesis.rays, "", _unless(s, "rays", counted)),
        ]
    source = _unless(s, "checked_penalty", "the robot's own, or Eq. (11)")
    return [
        *rows,
        ("γ that is proved", proved.gamma, "", "searched"),
        ("penalty whose gain is proved", str(proved.problem.penalty.states), "", source),
        ("R2 of that penalty", proved.problem.r2, "", source),
    ]


def _units(e: LawEvaluation) -> str:
    """The unit of link positions, or that of each joint where they differ."""
    units = [e.setup.model.unit(name) for name in signal_names("link_position", e.setup.joints)]
    return units[0] if len(set(units)) == 1 else ", ".join(units)


def _estimator(e: LawEvaluation) -> Rows:
    s, plant, noise = e.setup.specification, e.setup.model, e.setup.process_noise
    rows: Rows = [("estimator", s.estimator, "", _option(s, "estimator"))]
    if s.estimator == "none":
        return [*rows, ("fed back", "the true state", "", "option --estimator none")]
    variances = zip(plant.outputs, noise_variances(plant, s.measurement_noise))
    initial = "stationary covariance of the filter in equilibrium at the goal"
    links, motors = (
        list(levels) if isinstance(levels, tuple) else levels
        for levels in (noise.link_velocities, noise.motor_velocities)
    )
    return [
        *rows,
        ("measured", list(plant.outputs), "", _option(s, "measured")),
        *(
            (
                f"Rⁿ of {name.replace('_', ' ')}",
                float(v),
                f"({plant.unit(name)})²",
                _option(s, "measurement_noise"),
            )
            for name, v in variances
        ),
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
    s, runs, filter = e.setup.specification, e.scenario, e.loop.filter
    assert runs is not None
    extras = f", with {', '.join(s.extras)}" if s.extras else ", no extras"
    limits = e.setup.limits
    inputs, speeds = (
        limit_text(one) if np.isfinite(one).any() else "none" for one in (limits.saturation, limits.speed)
    )
    stated = [
        source if source == ROBOT else f"option {source}"
        for source in (limits.saturation_source, limits.speed_source)
    ]
    quanta = [0.0] if e.setup.quantisation is None else np.atleast_1d(e.setup.quantisation).tolist()
    steps, seed = "Runge–Kutta steps per period", f"uniform within the tolerances, seed ({s.seed}, 7)"
    rows: Rows = [
        ("start pose", e.setup.start, _units(e),
         _unless(s, "start", "ours: 0.1 rad (10 mm) from the goal")),
        ("command", "the goal, from the first sample on" if e.setup.command is None else e.setup.command.name, "",
         _option(s, "shaping")),
        ("move", runs.plan.name, "", _unless(s, "move", "ours: the way of the step")),
        ("true plant", f"nominal numbers{extras}", "", _option(s, "extras")),
        ("extras that the linear loop leaves out", list(e.setup.left_out) or "none", "",
         "ours: their slope at standstill holds only for the smallest velocities"),
        ("sampling period", s.period, "s", _option(s, "period")),
        ("delay of the inputs", s.delay, "s", _option(s, "delay")),
        ("quantisation of the measurements", quanta[0] if len(set(quanta)) == 1 else quanta, "",
         _option(s, "quantisation")),
        ("dead zone of the integrals", "none" if e.setup.dead_zone is None else e.setup.dead_zone, _units(e),
         _unless(s, "integral_dead_zone", "ours: against hunting")),
        ("limits of the inputs", inputs, units_of(e).effort if limits.saturated is not None else "",
         stated[0]),
        ("limits of the speeds", speeds, units_of(e).speed if limits.limits_speed else "",
         stated[1]),
        ("length of the step", runs.step_duration, "s",
         _unless(s, "duration", "by the slowest mode, 0.5 to 20 s")),
        ("load", runs.load, e.setup.model.unit(e.setup.model.disturbances[0]),
         _unless(s, "load", "a tenth of what the motors give at the peak of the step")),
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
