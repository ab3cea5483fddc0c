"""The report of a comparison on one page: criterion, best rival, figures, pictures, the laws and their tuning."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.design.criterion import RATIOS
from flexhinf.design.laws import DEFAULT_LAWS, DESIGN, NL_HINF
from flexhinf.design.result import ComparedLaw, Comparison
from flexhinf.design.tuning import TunedLaw, ranked, trade_offs
from flexhinf.pages.design.frequency import Loop, frequency_figures
from flexhinf.pages.design.laws import (
    FIGURES,
    LawFigure,
    cell,
    metric_table,
    responses_figure,
    trade_off_figure,
    unit_of,
)
from flexhinf.pages.design.requirements import requirement_text
from flexhinf.pages.drawing import (
    ESTIMATORS,
    count_text,
    joint_count,
    law_name,
    pose_text,
    units_of,
)
from flexhinf.pages.settings import comparison_settings, files_section
from flexhinf.pages.verdict import (
    EQUAL,
    called,
    comparison_verdict,
    ours_of,
    rival_of,
    tuned_laws,
)
from flexhinf.report import (
    Column,
    KeyNumber,
    Note,
    Page,
    Paragraph,
    Provenance,
    Section,
    Settings,
    Status,
    Table,
    number,
)

#: Figures at the top of the page.
KEYS = (
    "load_deviation",
    "step_settling_s",
    "move_error",
    "load_remaining",
    "peak_sensitivity",
    "unstable_corners",
    "input_noise",
)

#: Laws in the frequency figures, the best by the criterion.
DRAWN = 4

#: What a law needs of the state, in the order of the model.
SIGNALS = ("link_position", "link_velocity", "motor_position", "motor_velocity")


def comparison_page(
    comparison: Comparison, command: Sequence[str], warnings: Sequence[str] = (), files: Sequence[str] = ()
) -> Page:
    """Everything on one page; parameters as for `flexhinf.pages.page.design_page`."""
    notes = [
        *(Note(text) for text in comparison_notes(comparison)),
        *(Note(" ".join(t.split())) for t in warnings),
    ]
    sections = [
        Section(
            "Laws by the criterion",
            (_limits(comparison), Paragraph(_ranking_text(comparison)), _ranking(comparison), *notes),
            "criterion",
        ),
        _trade_off(comparison),
        Section("Figures of every law", (metric_table(comparison, comparison.compared),), "figures"),
        Section("Step, load and move", (responses_figure(comparison),), "responses"),
        _frequency(comparison),
        Section("The laws and how they were tuned", tuple(_laws(comparison)), "laws"),
        *([files_section(files)] if files else []),
    ]
    return Page(
        f"Control laws compared on {comparison.robot.name}",
        _intro(comparison),
        _whole(comparison_verdict(comparison)),
        tuple(section for section in sections if section is not None),
        Settings(comparison_settings(comparison)),
        Provenance(tuple(command), comparison.specification.seed),
        _key_numbers(comparison),
        _status(comparison),
    )


def _intro(comparison: Comparison) -> str:
    """Robot, step, and the criterion, before any verdict."""
    own, s = comparison.own.evaluation, comparison.specification
    assert own is not None
    slides, degrees = comparison.robot.links.slides, s.in_degrees
    way = f"{pose_text(own.setup.start, slides, degrees)} to {pose_text(own.setup.goal, slides, degrees)}"
    return (
        f"{comparison.robot.name}, {joint_count(len(own.setup.joints))}, {comparison.robot.drive} driven; step from "
        f"{way}. {count_text(len(comparison.compared), 'law')} with the same commands, load, move, robots and seeds. "
        f"“{DESIGN}” is the law as flexhinf design makes it (preset {comparison.synthesis.design_problem.preset}, "
        f"{law_name(comparison.synthesis.chosen.degree)}, {ESTIMATORS[s.estimator]}); {NL_HINF} is the same problem "
        f"tuned as the other laws are. Criterion: {comparison.criterion.measure} All keep the same limits, which stand "
        "below."
    ).replace(NL_HINF, _whole(NL_HINF))


def _status(comparison: Comparison) -> list[Status]:
    """What the design's own law misses of the specification, and what was only sampled."""
    own = comparison.own.evaluation
    assert own is not None
    degrees = units_of(own).degrees
    missed = [line.shown(degrees) for line in comparison.own.requirements if not line.met]
    found = [Status("met", f"The design meets {len(comparison.own.requirements)} requirements.")]
    if missed:
        text = "; ".join(requirement_text(line) for line in missed)
        found = [Status("not met", f"The design as it is: {text}.")]
    return [
        *found,
        Status("not proved", "All figures are of simulated runs, of sampled robots and of the linear loop."),
    ]


def comparison_notes(comparison: Comparison) -> list[str]:
    """What the reader must not miss."""
    found = []
    for row in comparison.rows:
        if row.failure:
            found.append(f"{row.name} was not compared: {row.failure.rstrip('.')}.")
        if row.evaluation is not None and row.evaluation.linear_failure:
            found.append(
                f"The loop of {row.name} could not be linearised: {row.evaluation.linear_failure.rstrip('.')}."
            )
    own, s = comparison.own.evaluation, comparison.specification
    if own is not None and own.setup.left_out:
        names = " and ".join(own.setup.left_out).replace("_", " ")
        found.append(f"The linear loops leave out {names}, as in flexhinf design; the runs have it.")
    names = [row.name for row in comparison.compared]
    if comparison.synthesis.chosen.degree == 2 and "hinf" in names:
        found.append("The design chose degree 2: it is a linear law, as hinf is.")
    if s.via:
        found.append(
            "The design switches between laws of several poses; its linear figures are of the one at the goal, and the "
            "tuned laws have that one alone."
        )
    return found


# Sections --------------------------------------------------------------------------------------------------
def _ranking_text(comparison: Comparison) -> str:
    return (
        "The four columns of ratios are over those of the design as it is; the criterion is their geometric mean, and "
        "less is better. Every law here keeps every limit. One with more unstable corners of the tolerances than the "
        "design is not ranked. A law of which no tuning keeps every limit has no numbers, and is named with the reason "
        f"below. The searches are short: differences of less than {number(100 * EQUAL)} % say nothing."
    )


def _limits(comparison: Comparison) -> Table:
    """What every law keeps, and who says so."""
    rows = [
        (x.label.rstrip(","), f"{'≥' if x.least else '≤'} {number(x.value, 3)} {x.unit}".strip(), x.origin)
        for x in comparison.criterion.limits
    ]
    return Table(("limit for every law", "value", "stated by"), rows, id="table-limits")


def _ranking(comparison: Comparison) -> Table:
    """Ranked laws first, by the criterion."""
    laws = tuned_laws(comparison)
    first = {law.name for law in ranked(laws)} | {DESIGN}
    rows = []
    for law in sorted(laws, key=lambda law: (law.name not in first, law.cost)):
        ratios, corners = comparison.criterion.ratios(law.metrics), law.evaluation.corners
        rows.append(
            (
                _whole(f"{law.name}, as it is" if law.name == DESIGN else law.name),
                *(
                    value if np.isfinite(value) else None
                    for value in (law.cost, *(ratios[name] for name in RATIOS))
                ),
                "–" if corners is None else corners.unstable,
                ", ".join(law.sensors).replace("_", " ") or "true state",
                "yes" if law.name in first else "no: more unstable corners than the design",
            )
        )
    figures = (Column(name, "", 2) for name in ("criterion", *RATIOS.values()))
    columns = ("law", *figures, "unstable corners", "measured", "ranked")
    return Table(columns, rows, "", "table-criterion", stacks=True)


def _trade_off(comparison: Comparison) -> Section | None:
    figure = trade_off_figure(comparison, trade_offs(tuned_laws(comparison), comparison.criterion))
    return None if figure is None else Section("Trade-off", (figure,), "trade-off")


def _frequency(comparison: Comparison) -> Section | None:
    """The design, nonlinear H∞ and the best others, in one joint."""
    laws = [law for law in tuned_laws(comparison) if not law.evaluation.linear_failure]
    always = (DESIGN, NL_HINF)
    others = sorted((law for law in laws if law.name not in always), key=lambda law: law.cost)
    chosen = [*(law for law in laws if law.name in always), *others[: DRAWN - 1]]
    if not chosen:
        return None
    place = {row.name: k for k, row in enumerate(comparison.rows)}  # a law looks the same in every figure
    loops = [Loop(law.name, law.evaluation.frequency_response, place[law.name]) for law in chosen]
    units = comparison.units()
    figures = frequency_figures(loops, comparison.robot.joint_names, units["torque"], units["position"])
    return Section("Frequency responses", tuple(figures), "frequency")


def _key_numbers(comparison: Comparison) -> list[KeyNumber]:
    """Figures of nonlinear H∞ beside those of the best rival."""
    rival, ours, found = rival_of(comparison), ours_of(comparison), []
    for figure in (f for key in KEYS for f in FIGURES if f.key == key):
        if ours.evaluation.metrics.get(figure.key) is None:
            continue
        note = "" if rival is None else f"{_whole(rival.name)}: {_cell_of(comparison, figure, rival)}"
        label = f"{_whole(called(ours))}: {figure.label}"
        found.append(KeyNumber(label, _cell_of(comparison, figure, ours), unit_of(figure, comparison), note))
    return found


def _cell_of(comparison: Comparison, figure: LawFigure, law: TunedLaw) -> str:
    return cell(figure, law.evaluation.metrics.get(figure.key), comparison)


def _laws(comparison: Comparison) -> list[Any]:
    text = (
        "Every law but the design as it is, is tuned over all its parameters and the noise levels of its estimator, in "
        "three rounds with as many candidates per parameter, with the sensors that its proponents would choose. All "
        "make the step as they would be deployed: the input continues from what held the robot at the start, by the "
        "integrals, and by a bias that fades where a law has none. The move is followed in error coordinates, "
        "(x_d, u_d) from the elastic inverse dynamics."
    )
    columns = (
        "law",
        "what it is",
        "tuned",
        "candidates",
        "measured",
        "needs of the state",
        "knows",
        "source",
    )
    return [Paragraph(text), Table(columns, [_law_cells(row) for row in comparison.rows], stacks=True)]


def _law_cells(row: ComparedLaw) -> tuple[Any, ...]:
    tuned, kind = row.tuned, row.kind
    labels = {p.name: (p.label, p.unit) for p in kind.parameters}
    values = {} if tuned is None else tuned.parameters
    parts = []
    for name, value in values.items():
        text, unit = labels.get(name, (name.replace("_", " "), ""))
        parts.append(f"{text} {number(value, 3)}{f' {unit}' if unit else ''}")
    sensors = [] if tuned is None else [name.replace("_", " ") for name in tuned.sensors]
    return (
        _whole(row.name),
        kind.description,
        ", ".join(parts) or (f"not compared: {row.failure}" if row.failure else "–"),
        "–" if tuned is None or not tuned.candidates else str(tuned.candidates),
        ", ".join(sensors) or "–",
        _needs(row),
        kind.model,
        kind.source,
    )


def _needs(row: ComparedLaw) -> str:
    """States by kind, and integrals."""
    if row.evaluation is None:
        return "–"
    states = row.evaluation.needed_states
    kinds = [name.replace("_", " ") for name in SIGNALS if any(_is(name, state) for state in states)]
    integral = ["integral of the link's error"] if any(s.endswith("_integral") for s in states) else []
    everything = ["all four states"] if len(kinds) == len(SIGNALS) else kinds
    return ", ".join([*everything, *integral]) or "–"


def _is(name: str, state: str) -> bool:
    return not state.endswith("_integral") and (state == name or state.startswith(f"{name}_"))


def _whole(text: str) -> str:
    """Names of laws with hyphens at which no line breaks."""
    for name in sorted((n for n in DEFAULT_LAWS if "-" in n), key=len, reverse=True):
        text = text.replace(name, name.replace("-", "\u2011"))
    return text
