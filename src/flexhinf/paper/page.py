"""The report: what was reproduced, verdict per claim, figures, tables, every setting."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from flexhinf.paper.bench import INITIAL_VARIANCE
from flexhinf.paper.claims import Judged
from flexhinf.paper.experiments import (
    DISTURBED_FROM,
    FREQUENCY,
    PLANTS,
    TORQUE,
    UNCERTAIN_DURATION,
    Experiments,
)
from flexhinf.paper.figures import Drawn
from flexhinf.paper.numbering import numbered
from flexhinf.paper.openings import misprint_table, open_table
from flexhinf.paper.settings import PaperSettings
from flexhinf.report import (
    Claims,
    KeyNumber,
    Listing,
    Page,
    Paragraph,
    Provenance,
    Section,
    Setting,
    Settings,
    summary,
)

__all__ = ["paper_page"]


def paper_page(
    experiments: Experiments, drawn: Sequence[Drawn], judged: Sequence[Judged], command: Sequence[str]
) -> Page:
    """Everything on one page."""
    judged = numbered(judged, first_figure=13)
    bench, claims = experiments.bench, [j.claim for j in judged]
    return Page(
        "Nonlinear H∞ control of a flexible joint, reproduced",
        "Elsa & Akbari (2014): the single-link arm of Sec. 6, its Figures 3–12 and its claims, computed again from its "
        f"equations and tables. Here the law is fed with {bench.feedback}.",
        summary(claims),
        (
            Section("Verdict per claim", (Paragraph(_reading()), Claims(claims)), "claims"),
            Section("Figures 3–12", tuple(d.block for d in drawn), "figures"),
            Section("What shows it", tuple(block for j in judged for block in j.blocks), "evidence"),
            Section("What was taken instead", (misprint_table(), open_table()), "instead"),
            Section("The law", (Paragraph(_law_text(experiments)), Listing(bench.nonlinear.report())), "law"),
        ),
        Settings(_settings(experiments)),
        Provenance(tuple(command), bench.settings.seed),
        _numbers(experiments),
    )


def _reading() -> str:
    return (
        "Each claim has a stated criterion, a verdict computed from it, and the numbers behind it; another "
        "option may turn a verdict. “Repaired by” is the smallest change of the design that makes a failed claim hold."
    )


def _numbers(experiments: Experiments) -> list[KeyNumber]:
    bench = experiments.bench
    numbers = [
        KeyNumber("smallest feasible γ*", f"{bench.gamma_star:.4f}"),
        KeyNumber("γ used", f"{bench.gamma:.4f}", note=f"{bench.settings.gamma_ratio:g} γ*"),
    ]
    for goal, runs in (("180°", experiments.step_180), ("90°", experiments.step_90)):
        ours, linear = (runs[name].metrics["overshoot_percent"] for name in ("nonlinear", "linear"))
        shown = "diverged" if ours is None else round(ours, 2)
        note = "L-H∞ diverged" if linear is None else f"L-H∞: {linear:.1f} %"
        numbers.append(KeyNumber(f"overshoot, {goal} step", shown, "" if ours is None else "%", note))
    return numbers


def _law_text(experiments: Experiments) -> str:
    bench = experiments.bench
    gain = ", ".join(f"{k:.4g}" for k in bench.linear.law_data)
    return (
        f"V of degree {bench.settings.degree} solves Eq. (8) at γ = {bench.gamma:.4f}; "
        f"its linear part is u = ({gain}) · (x1, x2, x3, x4, x5)."
    )


def _settings(experiments: Experiments) -> dict[str, list[Setting]]:
    bench, s = experiments.bench, experiments.bench.settings
    default = PaperSettings()
    steps = {coil: _sub_steps(experiments, coil) for coil in (False, True)}

    def option(name: str, value: Any, flag: str, unit: str = "") -> Setting:
        chosen = "default" if value == getattr(default, name) else "option"
        return Setting(name.replace("_", " "), value, unit, f"{chosen} {flag}")

    arm = [
        Setting(p.name.replace("_", " "), f"{p.value:g} ± {p.tolerance:g} %", p.unit, p.source)
        for p in bench.arm.parameters
    ]
    return {
        "Options": [
            option("gamma_ratio", s.gamma_ratio, "--gamma-ratio"),
            option("degree", s.degree, "--degree"),
            option("period", s.period, "--period", "s"),
            option("seed", s.seed, "--seed"),
            option("estimator", s.estimator, "--estimator"),
            option("process_noise", s.process_noise, "--process-noise", "q of R^v = q I"),
            option("measurement_noise", s.measurement_noise, "--measurement-noise", "rad²"),
        ],
        "Arm": arm,
        "Synthesis": [
            Setting("penalty", "(60 x1, 0, 0, 0, 300 x5), R2 = 10", "", "Eq. (11)"),
            Setting("γ*", bench.gamma_star, "", "bisection, relative 1e-8"),
            Setting("γ", bench.gamma, "", "ours"),
            Setting("expansion", "about the hanging rest", "", "Sec. 6"),
        ],
        "Estimator": [
            Setting("α, β, κ", "1, 2, 0", "", "Table 3"),
            Setting("initial estimate", "rest", "", "ours"),
            Setting("P0", f"{INITIAL_VARIANCE:g} I", "", "ours"),
            Setting(
                "simulated noise",
                f"{math.sqrt(s.measurement_noise):.3g}",
                "rad (standard deviation)",
                "as R^n",
            ),
        ],
        "Simulation": [
            Setting("sub-steps per period", steps[False], "", "Runge–Kutta, plant without coil"),
            Setting("sub-steps per period", steps[True], "", "Runge–Kutta, plant with coil"),
            Setting("plants drawn", PLANTS, "", "ours"),
            Setting("length of runs under tolerances", UNCERTAIN_DURATION, "s", "ours"),
            Setting("disturbance torque", TORQUE, "N·m", "ours"),
            Setting("disturbance from", DISTURBED_FROM, "s", "ours"),
            Setting("disturbance frequency", FREQUENCY, "Hz", "ours"),
        ],
    }


def _sub_steps(experiments: Experiments, coil: bool) -> int:
    bench = experiments.bench
    return bench.loop(bench.nonlinear, None, coil).sub_steps
