"""Every setting of a design with who says so, and every number of the robot with its source."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.design.estimator import INITIAL_VARIANCE, noise_variances
from flexhinf.design.page.weights_of import effort_unit, state_weights
from flexhinf.design.result import Design
from flexhinf.design.specification import Specification
from flexhinf.report import Setting

__all__ = ["setting_groups"]


def setting_groups(design: Design) -> dict[str, list[Setting]]:
    """For the report, in the order of the work."""
    return {
        "Robot": _robot(design),
        "Synthesis": _synthesis(design),
        "Estimator": _estimator(design),
        "Simulation": _simulation(design),
    }


def _robot(design: Design) -> list[Setting]:
    robot = design.robot
    rows = [Setting("joints", list(robot.joint_names), "", robot.name)]
    for p in robot.parameters:
        tolerance = f" ± {p.tolerance:g} %" if p.tolerance else ""
        rows.append(Setting(p.name.replace("_", " "), f"{p.value:g}{tolerance}", p.unit, p.source))
    return rows


def _option(design: Design, name: str) -> str:
    same = getattr(design.specification, name) == getattr(Specification(), name)
    return f"{'default of' if same else 'option'} --{name.replace('_', '-')}"


def _synthesis(design: Design) -> list[Setting]:
    s, problem = design.specification, design.problem
    penalty = problem.penalty
    rows = [
        Setting("preset", design.game.preset, "", "option --preset" if s.preset else "by what was asked for"),
        Setting("pose", design.goal, "rad or m", "the robot's home" if s.pose is None else "option --pose"),
        *(
            Setting(f"weight of {w.signal.replace('_', ' ')}", w.value, w.unit, design.game.source)
            for w in state_weights(design)
        ),
        Setting("R2", np.asarray(penalty.effort), effort_unit(design), design.game.effort_source),
        Setting("disturbances", list(problem.disturbance_names), "", _option(design, "disturbances")),
        Setting("integrated errors", list(problem.integrate), "", "ours"),
        Setting("γ*", design.gamma_star, "", "bisection, relative 1e-8"),
        Setting("γ/γ*", s.gamma_ratio, "", _option(design, "gamma_ratio")),
        Setting(
            "degrees of V tried",
            [c.degree for c in design.choices],
            "",
            "for the number of states" if s.degrees is None else "option --degrees",
        ),
        Setting("checked γ/γ*", s.checked_gamma_ratio, "", _option(design, "checked_gamma_ratio")),
        Setting("checked penalty", _checked(s), "", _option(design, "checked_penalty")),
        Setting("rays", design.rays, "", "for the number of states" if s.rays is None else "option --rays"),
    ]
    return rows


def _checked(s: Specification) -> Any:
    return "0.9 × the designed one" if s.checked_penalty is None else str(s.checked_penalty)


def _belief(s: Specification) -> str:
    if not max(s.noises):
        return f"{INITIAL_VARIANCE:g} I"
    return "that of the filter after very many samples at rest at the goal"


def _estimator(design: Design) -> list[Setting]:
    s, plant = design.specification, design.problem.plant
    rows = [Setting("estimator", s.estimator, "", _option(design, "estimator"))]
    if s.estimator == "none":
        return [*rows, Setting("fed back", "the true state", "", "option --estimator none")]
    rows.append(Setting("measured", list(plant.outputs), "", _option(design, "measured")))
    for name, variance in zip(plant.outputs, noise_variances(plant, s.measurement_noise)):
        rows.append(
            Setting(
                f"Rⁿ of {name.replace('_', ' ')}",
                float(variance),
                f"({plant.unit(name)})²",
                _option(design, "measurement_noise"),
            )
        )
    return [
        *rows,
        Setting("simulated noise", "white, of these variances", "", "ours"),
        Setting("Rᵛ on every state", s.noises[0], "per sample", _option(design, "process_noise")),
        Setting("Rᵛ on the velocities beside", s.noises[1], "per sample", _option(design, "torque_noise")),
        Setting("initial estimate", "the rest at the start of the step", "", "ours"),
        Setting("P0", _belief(s), "", "ours"),
        Setting("model", "the nominal robot without extras", "", "ours"),
        *(
            [Setting("α, β, κ", "1, 2, 0", "", "Table 3 of Elsa & Akbari 2014")]
            if s.estimator == "ukf"
            else []
        ),
    ]


def _simulation(design: Design) -> list[Setting]:
    s = design.specification
    model, true = design.sub_steps
    return [
        Setting(
            "start pose",
            design.start,
            "rad or m",
            "ours: 0.1 rad (10 mm) from the goal" if s.start is None else "option --from-pose",
        ),
        Setting("command", "the goal, from the first sample on", "", "ours"),
        Setting(
            "true plant",
            "nominal numbers" + (f", with {', '.join(s.extras)}" if s.extras else ", no extras"),
            "",
            _option(design, "extras"),
        ),
        Setting("sampling period", s.period, "s", _option(design, "period")),
        Setting(
            "limits of the inputs",
            "none" if s.saturation is None else f"± {s.saturation:g}",
            "",
            _option(design, "saturation"),
        ),
        Setting(
            "length",
            design.duration,
            "s",
            "8 time constants of the slowest mode, 0.5 to 20 s"
            if s.duration is None
            else "option --duration",
        ),
        Setting("Runge–Kutta steps per period", true, "", "true plant: step × fastest mode ≤ 0.01"),
        *(
            [
                Setting(
                    "Runge–Kutta steps per period", model, "", "estimator's model: step × fastest mode ≤ 0.25"
                )
            ]
            if model
            else []
        ),
    ]
