"""The report of a comparison on one page, and its verdict: the best rival against nonlinear H∞, both tuned alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.design.laws import DEFAULT_LAWS, DESIGN, NL_HINF, is_hinf
from flexhinf.design.result import Comparison
from flexhinf.design.tuning import (
    RATIOS,
    TunedLaw,
    best_rival,
    ranked,
    unstable_corners,
)
from flexhinf.pages.design.frequency import Loop, frequency_figures
from flexhinf.pages.design.laws import (
    METRICS,
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
from flexhinf.pages.page import comparison_settings, files_section
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
    "load_deviation", "step_settling_s", "move_error", "load_remaining", "peak_sensitivity", "unstable_corners",
    "input_noise",
)  # fmt: skip

#: Laws in the frequency figures, the best by the criterion.
CURVES = 4

#: What a law needs of the state, in the order of the model.
SIGNALS = ("link_position", "link_velocity", "motor_position", "motor_velocity")


#: How the table of the criterion is read.
RANKING = (
    "The four columns of ratios are over those of the design as it is; the criterion is their geometric mean, and "
    "less is better; differences of less than 10 % say nothing. Every law here keeps every limit. One with more "
    "unstable corners of the tolerances than the design is not ranked; a law of which no tuning keeps every limit is "
    "named with the reason below."
)

#: Differences of the criterion smaller than this fraction say nothing: two searches of one law end so far apart.
EQUAL = 0.1


# Verdict -----------------------------------------------------------------------------------------------------
def tuned_laws(comparison: Comparison) -> list[TunedLaw]:
    """Every law that is compared, the design's own first."""
    return [row.tuned for row in comparison.compared if row.tuned is not None]


def ours_of(comparison: Comparison) -> TunedLaw:
    """The best nonlinear H∞ law tuned as the rivals are; the design itself where that keeps no limit or is worse."""
    design = comparison.own.tuned
    assert design is not None
    return min(
        [*(law for law in ranked(tuned_laws(comparison)) if is_hinf(law.name)), design],
        key=lambda law: law.cost,
    )


def called(law: TunedLaw) -> str:
    """Name of a law in a sentence."""
    return "the design" if law.name == DESIGN else law.name


def _whole(text: str) -> str:
    """Replace the hyphens in names of laws by ones at which no line breaks."""
    for name in sorted((n for n in DEFAULT_LAWS if "-" in n), key=len, reverse=True):
        text = text.replace(name, name.replace("-", "\u2011"))
    return text


def comparison_verdict(comparison: Comparison) -> str:
    """The best rival against nonlinear H∞, both tuned alike; where ours loses, the first sentence says so."""
    laws, ours = tuned_laws(comparison), ours_of(comparison)
    rival, name = best_rival(laws), called(ours)
    if all(is_hinf(row.name) for row in comparison.rows):
        return f"No other law could be compared with {name}."
    if rival is None:
        text = (
            "No other law keeps every limit with at most as many unstable corners as the design, so none is ranked "
            f"against {name}."
        )
        others, own = [law for law in laws if not is_hinf(law.name)], comparison.own.evaluation
        if others and own is not None:
            law = min(others, key=lambda law: law.cost)
            text += (
                f" The smallest criterion has {law.name} ({number(law.cost, 3)}), with "
                f"{unstable_corners(law.evaluation)} unstable corners against {unstable_corners(own)}."
            )
        return text
    costs = f"{number(rival.cost, 3)} against {number(ours.cost, 3)}; less is better"
    nothing = "so by this criterion nonlinear H∞ buys nothing on this robot."
    if rival.cost < ours.cost * (1.0 - EQUAL):
        text = f"The best rival, {rival.name}, beats {name} by the criterion ({costs}), {nothing}"
    elif rival.cost <= ours.cost * (1.0 + EQUAL):
        text = (
            f"Between the best rival, {rival.name}, and {name} there is no difference that the search can tell "
            f"({costs}), {nothing}"
        )
    else:
        text = f"The best rival, {rival.name}, loses to {name} by the criterion ({costs})."
    better = [
        f"{law.name} ({number(law.cost, 3)})"
        for law in ranked(laws)
        if law is not rival and not is_hinf(law.name) and law.cost < ours.cost * (1.0 - EQUAL)
    ]
    if better:
        text += f" Better than {name} {'is' if len(better) == 1 else 'are'} also {', '.join(better[:3])}."
    theirs, mine = (comparison.criterion.ratios(law.metrics) for law in (rival, ours))
    *parts, last = [f"{number(theirs[key] / mine[key], 3)} times the {what}" for key, what in RATIOS.items()]
    text += f" Relative to {name}, {rival.name} has {', '.join(parts)} and {last}."
    design = comparison.own.tuned
    if design is not None and ours is not design:
        text += f" The design as it is, not tuned for the criterion, has {number(design.cost, 3)}."
    return text


# Page --------------------------------------------------------------------------------------------------------
def comparison_page(
    comparison: Comparison, command: Sequence[str], warnings: Sequence[str] = (), files: Sequence[str] = ()
) -> Page:
    """The page of a comparison; parameters as for `flexhinf.pages.page.design_page`."""
    own, s, robot = comparison.own.evaluation, comparison.specification, comparison.robot
    assert own is not None
    slides, degrees = robot.links.slides, s.in_degrees
    way = f"{pose_text(own.setup.start, slides, degrees)} to {pose_text(own.setup.goal, slides, degrees)}"
    notes = (*comparison_notes(comparison), *(" ".join(text.split()) for text in warnings))
    trade_off = trade_off_figure(comparison, tuned_laws(comparison))
    blocks: dict[tuple[str, str], Sequence[Any]] = {
        ("criterion", "Laws by the criterion"): (
            Table(("limit for every law", "value", "stated by"),
            [
                (x.label.rstrip(","), f"{'≥' if x.least else '≤'} {number(x.value, 3)} {x.unit}".strip(), x.origin)
                for x in comparison.criterion.limits
            ],
            id="table-limits"), Paragraph(RANKING),
            _ranking(comparison), *map(Note, notes),
        ),
        ("trade-off", "Trade-off"): () if trade_off is None else (trade_off,),
        ("figures", "Figures of every law"): (metric_table(comparison, comparison.compared),),
        ("responses", "Step, load and move"): (responses_figure(comparison),),
        ("frequency", "Frequency responses"): _frequency(comparison),
        ("laws", "The laws and how they were tuned"): _laws(comparison),
    }  # fmt: skip
    sections = [Section(title, tuple(parts), anchor) for (anchor, title), parts in blocks.items() if parts]
    missed = [line.converted(units_of(own).degrees) for line in comparison.own.requirements if not line.met]
    kept = ("met", f"The design meets {len(comparison.own.requirements)} requirements.")
    unmet = ("not met", f"The design as it is: {'; '.join(map(requirement_text, missed))}.")
    return Page(
        f"Control laws compared on {robot.name}",
        (f"{robot.name}, {joint_count(len(own.setup.joints))}, {robot.drive} driven; step from {way}. "
            f"{count_text(len(comparison.compared), 'law')} with the same commands, load, move, robots, seeds and limits. "
            f"“{DESIGN}” is the law as flexhinf design makes it (preset {comparison.synthesis.design_problem.preset}, "
            f"{law_name(comparison.synthesis.chosen.degree)}, {ESTIMATORS[s.estimator]}); {_whole(NL_HINF)} is the same "
            f"problem tuned as the other laws are. Criterion: {comparison.criterion.measure}"),
        _whole(comparison_verdict(comparison)),
        (*sections, *([files_section(files)] if files else [])), Settings(comparison_settings(comparison)),
        Provenance(tuple(command), s.seed), _key_numbers(comparison), [Status(*(unmet if missed else kept)),
        Status(
            "not proved", "All figures are of simulated runs, of sampled robots and of the linear loop."
        )],
    )  # fmt: skip


def comparison_notes(comparison: Comparison) -> list[str]:
    """Limits of the comparison that the reader must know."""
    notes, own, s = [], comparison.own.evaluation, comparison.specification
    for row in comparison.rows:
        if row.failure:
            notes.append(f"{row.name} was not compared: {row.failure.rstrip('.')}.")
        if row.evaluation is not None and row.evaluation.linear_failure:
            notes.append(
                f"The loop of {row.name} could not be linearised: {row.evaluation.linear_failure.rstrip('.')}."
            )
    if own is not None and own.setup.left_out:
        names = " and ".join(own.setup.left_out).replace("_", " ")
        notes.append(f"The linear loops leave out {names}, as in flexhinf design; the runs have it.")
    if comparison.synthesis.chosen.degree == 2 and any(row.name == "hinf" for row in comparison.compared):
        notes.append("The design chose degree 2: it is a linear law, as hinf is.")
    if s.via:
        notes.append(
            "The design switches between laws of several poses; all else here is of the one at the goal."
        )
    return notes


# Sections --------------------------------------------------------------------------------------------------
def _ranking(comparison: Comparison) -> Table:
    laws = tuned_laws(comparison)
    first = {law.name for law in ranked(laws)} | {DESIGN}
    rows = []
    for law in sorted(laws, key=lambda law: (law.name not in first, law.cost)):
        ratios, corners = comparison.criterion.ratios(law.metrics), law.evaluation.corners
        values = (law.cost, *(ratios[name] for name in RATIOS))
        rows.append((
            _whole(f"{law.name}, as it is" if law.name == DESIGN else law.name),
            *(value if np.isfinite(value) else None for value in values),
            "–" if corners is None else corners.unstable,
            ", ".join(law.sensors).replace("_", " ") or "true state",
            "yes" if law.name in first else "no: more unstable corners than the design",
        ))  # fmt: skip
    return Table(
        (
            "law", *(Column(name, "", 2) for name in ("criterion", *RATIOS.values())), "unstable corners", "measured",
            "ranked",
        ),
        rows, "", "table-criterion", stacks=True,
    )  # fmt: skip


def _frequency(comparison: Comparison) -> list[Any]:
    laws = [law for law in tuned_laws(comparison) if not law.evaluation.linear_failure]
    always = (DESIGN, NL_HINF)
    chosen = [
        *(law for law in laws if law.name in always),
        *sorted((law for law in laws if law.name not in always), key=lambda law: law.cost)[: CURVES - 1],
    ]
    if not chosen:
        return []
    place = {row.name: k for k, row in enumerate(comparison.rows)}  # a law looks the same in every figure
    loops = [Loop(law.name, law.evaluation.frequency_response, place[law.name]) for law in chosen]
    units = comparison.units()
    return list(frequency_figures(loops, comparison.robot.joint_names, units["torque"], units["position"]))


def _key_numbers(comparison: Comparison) -> list[KeyNumber]:
    rival, ours, numbers = best_rival(tuned_laws(comparison)), ours_of(comparison), []
    for metric in (metric for key in KEYS for metric in METRICS if metric.key == key):
        values = [None if law is None else law.evaluation.metrics.get(metric.key) for law in (ours, rival)]
        mine, theirs = (cell(metric, value, comparison) for value in values)
        note = "" if rival is None else f"{_whole(rival.name)}: {theirs}"
        name = f"{_whole(called(ours))}: {metric.label}"
        numbers += [] if values[0] is None else [KeyNumber(name, mine, unit_of(metric, comparison), note)]
    return numbers


def _laws(comparison: Comparison) -> list[Any]:
    text = (
        "Every law but the design as it is, is tuned over all its parameters and the noise levels of its estimator, in "
        "three rounds with as many candidates per parameter, with the sensors that its proponents would choose. The "
        "step begins as it would be deployed: the input continues from what held the robot, by the integrals, and by a "
        "bias that fades where a law has none. The move is followed in error coordinates, (x_d, u_d) from the elastic "
        "inverse dynamics."
    )
    rows = []
    for row in comparison.rows:
        tuned, kind = row.tuned, row.kind
        labels, parts = {p.name: (p.label, p.unit) for p in kind.parameters}, []
        for name, value in ({} if tuned is None else tuned.parameters).items():
            what, unit = labels.get(name, (name.replace("_", " "), ""))
            parts.append(f"{what} {number(value, 3)} {unit}".strip())
        states = [] if row.evaluation is None else row.evaluation.needed_states
        own = [state for state in states if not state.endswith("_integral")]
        needs = [
            name.replace("_", " ") for name in SIGNALS if any(f"{s}_".startswith(f"{name}_") for s in own)
        ]
        needs = ["all four states"] if len(needs) == len(SIGNALS) else needs
        needs += ["integral of the link's error"] if len(own) < len(states) else []
        rows.append((
            _whole(row.name), kind.description,
            ", ".join(parts) or (f"not compared: {row.failure}" if row.failure else "–"),
            "–" if tuned is None or not tuned.candidates else str(tuned.candidates),
            ", ".join(name.replace("_", " ") for name in (() if tuned is None else tuned.sensors)) or "–",
            ", ".join(needs) or "–", kind.model, kind.source,
        ))  # fmt: skip
    columns = (
        "law", "what it is", "tuned", "candidates", "measured", "needs of the state", "knows", "source",
    )  # fmt: skip
    return [Paragraph(text), Table(columns, rows, stacks=True)]
