"""Every setting of a comparison with who says so: those of the design, and those that make it a fair one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.baselines.gains import INTEGRAL_RATE
from flexhinf.design.compare.linear import SMOOTH
from flexhinf.design.compare.makers import PD_DAMPING
from flexhinf.design.compare.names import REFERENCE
from flexhinf.design.compare.reference import LONGER
from flexhinf.design.compare.result import Comparison
from flexhinf.design.compare.shown import corners
from flexhinf.design.compare.tuned import EDGE, EVALUATIONS, MISSING, TOLERANCE
from flexhinf.design.compare.words import ORIGINS
from flexhinf.design.disturbed import BEGINNING, LOAD_SHARE
from flexhinf.design.page.settings import setting_groups as design_groups
from flexhinf.design.response import LONGEST
from flexhinf.report import Setting

__all__ = ["setting_groups"]


@dataclass(frozen=True, eq=False)
class _AsDesign:
    """What the settings of a design are read from."""

    robot: Any
    specification: Any
    game: Any
    problem: Any
    goal: np.ndarray
    start: np.ndarray
    gamma_star: float
    choices: Any
    rays: int
    sub_steps: tuple[int, int]
    duration: float


def setting_groups(comparison: Comparison) -> dict[str, list[Setting]]:
    """For the report: the comparison first, then the design's."""
    reference = comparison.reference
    synthesis, bench = reference.synthesis, reference.bench
    estimator = bench.estimator(bench.start)
    model = 0 if estimator is None else estimator.sub_steps
    told: Any = _AsDesign(
        reference.robot, reference.specification, synthesis.game, reference.problem, bench.goal, bench.start,
        synthesis.game.gamma_star, synthesis.choices, synthesis.rays, (model, comparison.sub_steps), reference.duration,
    )  # fmt: skip
    return {"Comparison": _comparison(comparison), **design_groups(told)}


def _comparison(comparison: Comparison) -> list[Setting]:
    reference, target = comparison.reference, comparison.target
    s = reference.specification
    unit = reference.unit if target.mode == "peak" else "rad/s"
    rows = [
        Setting("laws", [row.name for row in comparison.rows], "", "option --laws, or the default"),
        Setting("reference", REFERENCE, "", "the law of flexhinf design with these options"),
        Setting("tuned to the same", target.mode, "", "option --tune"),
    ]
    if target.value is not None:
        rows += [
            Setting(
                "target", target.value, unit, ORIGINS.get(target.origin, f"the {target.mode} of {REFERENCE}")
            ),
            Setting("target is met within", f"{100 * TOLERANCE:g} %", "", "ours"),
            Setting(
                "peak sensitivity of a tuned loop at most",
                max(EDGE, target.sensitivity),
                "",
                f"ours, or the reference's own; {MISSING:g} for a law that misses the target",
            ),
            Setting("tries of a search at most", EVALUATIONS, "", "ours"),
            Setting("tuned on", _tuned_on(comparison), "", "ours"),
        ]
    return [
        *rows,
        Setting(
            "step", "as each law is commanded: with integrals the input continues, without it jumps", "", "ours"
        ),
        Setting(
            "length of the steps", reference.step_duration, "s",
            f"{LONGER:g} times the design's own, at most {LONGEST:g} s" if s.duration is None else "option --duration",
        ),
        Setting("loop", "error coordinates about the goal or the move, the same for all laws", "", "ours"),
        Setting("estimator", "the design's for all laws; lqg has a linear Kalman filter", "", "ours"),
        Setting("damping ratio of pd, pid", PD_DAMPING, "", "ours: no overshoot for want of it"),
        Setting("damping ratio of torque, torque-i", 0.7, "", "ours"),
        Setting("pole of integrals over the bandwidth", INTEGRAL_RATE, "", "ours: pid, torque-i"),
        Setting("rotor inertia that torque makes felt", "a quarter of the motor's", "", "ours"),
        Setting("poles of flatness", "Bessel filter", "", "Thomson 1949"),
        Setting(
            "load", reference.load, reference.units["torque"],
            f"{100 * LOAD_SHARE:g} % of what the motors give at the peak of the design's own step"
            if s.load is None
            else "option --load",
        ),
        Setting("load begins at", f"{100 * BEGINNING:g} %", "of a run of twice the length", "ours"),
        Setting("plan of the move", float(reference.plan.duration), "s", "jerk limited, at the pace of the reference"),
        Setting(
            "robots within their tolerances", len(comparison.drawn), "",
            f"uniform, seed ({s.seed}, 7); noise of robot k: seed {s.seed} + 1 + k; the same for all laws",
        ),
        Setting(
            "corners of the tolerances", corners(comparison), "", "with each tolerance alone, and the nominal robot"
        ),
        Setting("extras in linearised loops", [e for e in s.extras if e in SMOOTH], "", "smooth at rest"),
    ]  # fmt: skip


def _tuned_on(comparison: Comparison) -> str:
    if comparison.target.mode == "bandwidth":
        return "the linearised loop with its estimator, |command → link position| as commanded: slowest joint"
    part = comparison.target.share
    way = "the step as commanded" if part == 1.0 else f"the last {100 * part:.3g} % of the step's way"
    return f"{way}: nominal robot, estimator, noise, no limits of the input"
