"""The report: verdict per claim, what fails first, evidence under each claim, figures, every setting."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from flexhinf.paper.claims import Judged
from flexhinf.paper.experiments import FREQUENCY, LOAD_FROM, TOLERANCE_DURATION, TORQUE, Experiments
from flexhinf.paper.figures import PaperFigure
from flexhinf.paper.loop_setup import (
    INITIAL_VARIANCE,
    SAMPLED_PLANTS,
    PaperSettings,
    misprint_table,
    open_table,
)
from flexhinf.report import (
    ClaimEvidence,
    Claims,
    Figure,
    KeyNumber,
    Listing,
    Page,
    Paragraph,
    Provenance,
    Section,
    Setting,
    Settings,
    Table,
    by_verdict,
    summary,
)


def paper_page(
    experiments: Experiments, figures: Sequence[PaperFigure], judged: Sequence[Judged], command: Sequence[str]
) -> Page:
    """Everything on one page."""
    tables = sum(isinstance(block, Table) for figure in figures for block in figure.blocks)
    paper, ours = numbered(judged, first_figure=13, first_table=1 + tables)
    setup, claims = experiments.setup, [j.claim for j in paper]
    own = tuple(block for figure in figures for block in _numbered_tables(figure))
    return Page(
        "Nonlinear H∞ control of a flexible joint, reproduced",
        "Elsa & Akbari (2014): the single-link arm of Sec. 6, its Figures 3–12 and its claims, computed again from its "
        "equations and tables. No printed curve was compared with a computed one: the text was read from a scan "
        f"without the pictures, so a claim is judged by what it says. The law acts on {_fed_back(experiments)}.",
        summary(claims),
        (
            Section("Verdict per claim", (Paragraph(_reading()), Claims(claims)), "claims"),
            Section("Figures 3–12", own, "figures"),
            Section("Evidence, claim by claim", _evidence(paper), "evidence"),
            Section("Our own questions", (Paragraph(_OURS), *_evidence(ours)), "ours"),
            Section("What was taken instead", (misprint_table(), open_table()), "instead"),
            Section("The law", (Paragraph(_law_text(experiments)), Listing(setup.nonlinear.report())), "law"),
        ),
        Settings(_settings(experiments)),
        Provenance(tuple(command), setup.settings.seed),
        _numbers(experiments),
    )


def _fed_back(experiments: Experiments) -> str:
    kind = experiments.setup.settings.estimator
    return "the true state" if kind == "none" else f"the estimate of the {kind.upper()}"


def _reading() -> str:
    return (
        "Each claim has a criterion, fixed before the result, a verdict computed from it, and the numbers behind it "
        "under “Evidence”; another option may turn a verdict. Nothing here is proved: stable or unstable is by the "
        "growth rates of the linear loop, the rest by runs and searches."
    )


_OURS = "The paper does not ask these. They are not counted among its claims."


def _evidence(judged: Sequence[Judged]) -> tuple[ClaimEvidence, ...]:
    """What fails first."""
    blocks = {j.claim.id: j.blocks for j in judged}
    return tuple(ClaimEvidence(claim, blocks[claim.id]) for claim in by_verdict([j.claim for j in judged]))


def _numbered_tables(figure: PaperFigure) -> list[Any]:
    """The figure's blocks; its table, the first of the page, has the number 1."""
    return [
        replace(block, id="table-1", caption=f"Table 1. {block.caption}")
        if isinstance(block, Table)
        else block
        for block in figure.blocks
    ]


def numbered(
    judged: Sequence[Judged], first_figure: int, first_table: int
) -> tuple[list[Judged], list[Judged]]:
    """The paper's claims and our questions, tables and figures numbered in the order of the page.

    Claims point at the numbers.
    """
    order = [c.id for own in (False, True) for c in by_verdict([j.claim for j in judged if j.ours == own])]
    ordered = sorted(judged, key=lambda j: order.index(j.claim.id))
    names: dict[str, str] = {}
    tables, figures = first_table - 1, first_figure - 1
    blocks: list[tuple[Any, ...]] = []
    for one in ordered:
        renamed: list[Any] = []
        for block in one.blocks:
            if isinstance(block, Table) and block.id:
                tables += 1
                names[block.id] = f"table-{tables}"
                caption = f"Table {tables}. {block.caption}"
                renamed.append(replace(block, id=names[block.id], caption=caption))
            elif isinstance(block, Figure):
                figures += 1
                names[block.id] = f"figure-{figures}"
                renamed.append(replace(block, id=names[block.id], label=f"Figure {figures}"))
            else:
                renamed.append(block)
        blocks.append(tuple(renamed))
    found = [
        replace(
            one,
            blocks=own,
            claim=replace(one.claim, figures=tuple(names.get(f, f) for f in one.claim.figures)),
        )
        for one, own in zip(ordered, blocks, strict=True)
    ]
    found.sort(key=lambda j: [one.claim.id for one in judged].index(j.claim.id))
    return [j for j in found if not j.ours], [j for j in found if j.ours]


def _numbers(experiments: Experiments) -> list[KeyNumber]:
    setup = experiments.setup
    numbers = [
        KeyNumber(
            "γ* of the paper's problem", f"{setup.gamma_star:.4f}", note="smallest feasible γ, by bisection"
        ),
        KeyNumber(
            "γ of the paper's law here",
            f"{setup.gamma:.4f}",
            note=f"{setup.settings.gamma_ratio:g} γ*; the paper gives none",
        ),
    ]
    for goal, runs in (("180°", experiments.step_180), ("90°", experiments.step_90)):
        ours, linear = (runs[name].metrics()["overshoot_percent"] for name in ("nonlinear", "linear"))
        shown = "diverged" if ours is None else round(ours, 2)
        note = "L-H∞ diverged" if linear is None else f"L-H∞: {linear:.1f} %"
        numbers.append(KeyNumber(f"overshoot, {goal} step", shown, "" if ours is None else "%", note))
    return numbers


def _law_text(experiments: Experiments) -> str:
    setup = experiments.setup
    gain = ", ".join(f"{k:.4g}" for k in setup.linear.law_data)
    return (
        f"V of degree {setup.settings.degree} solves Eq. (8) at γ = {setup.gamma:.4f}; "
        f"its linear part is u = ({gain}) · (x1, x2, x3, x4, x5)."
    )


def _settings(experiments: Experiments) -> dict[str, list[Setting]]:
    setup, s = experiments.setup, experiments.setup.settings
    default = PaperSettings()
    steps = {coil: _sub_steps(experiments, coil) for coil in (False, True)}

    def option(name: str, value: Any, flag: str, unit: str = "") -> Setting:
        chosen = "default" if value == getattr(default, name) else "option"
        return Setting(name.replace("_", " "), value, unit, f"{chosen} {flag}")

    arm = [
        Setting(p.name.replace("_", " "), f"{p.value:g} ± {p.tolerance:g} %", p.unit, p.source)
        for p in setup.arm.parameters
    ]
    return {
        "Options": [
            option("gamma_ratio", s.gamma_ratio, "--gamma-ratio"),
            option("degree", s.degree, "--degree"),
            option("period", s.period, "--period", "s"),
            option("seed", s.seed, "--seed"),
            option("estimator", s.estimator, "--estimator"),
            option("process_noise", s.process_noise, "--process-noise", "q of Rᵛ = q I"),
            option("measurement_noise", s.measurement_noise, "--measurement-noise", "rad²"),
        ],
        "Arm": arm,
        "Synthesis": [
            Setting("penalty", "(60 x1, 0, 0, 0, 300 x5), R2 = 10", "", "Eq. (11)"),
            Setting("γ* of the paper's problem", setup.gamma_star, "", "bisection, relative 1e-8"),
            Setting("γ", setup.gamma, "", "ours"),
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
                "as Rⁿ",
            ),
        ],
        "Simulation": [
            Setting("sub-steps per period", steps[False], "", "Runge–Kutta, plant without coil"),
            Setting("sub-steps per period", steps[True], "", "Runge–Kutta, plant with coil"),
            Setting("plants sampled", SAMPLED_PLANTS, "", "ours"),
            Setting("length of runs under tolerances", TOLERANCE_DURATION, "s", "ours"),
            Setting("disturbance torque", TORQUE, "N·m", "ours"),
            Setting("disturbance from", LOAD_FROM, "s", "ours"),
            Setting("disturbance frequency", FREQUENCY, "Hz", "ours"),
        ],
    }


def _sub_steps(experiments: Experiments, coil: bool) -> int:
    setup = experiments.setup
    return setup.loop(setup.nonlinear, None, coil).sub_steps
