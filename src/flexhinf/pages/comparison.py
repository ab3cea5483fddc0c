"""The report of a comparison on one page, and its verdict: the best rival against nonlinear H∞, both tuned alike; laws
beside each other: the table of their metrics, their errors in the same runs, and input against deviation."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from flexhinf.design.laws import DESIGN, LAWS, NL_HINF, is_hinf, rivals
from flexhinf.design.pipeline import ComparedLaw, Comparison
from flexhinf.design.specification import ESTIMATED_BY
from flexhinf.design.tuning import RATIOS, TunedLaw, best_rival, ranked
from flexhinf.design.verdict import UNKNOWN, DesignVerdict
from flexhinf.numerals import number
from flexhinf.pages.comparison_figures import (
    arms_of,
    ranking_figure,
    responses_figure,
    small_of,
    trade_off_figure,
)
from flexhinf.pages.design.frequency import LoopLine, frequency_figures
from flexhinf.pages.drawing import count_text, joint_count, law_name, pose_text, units_of
from flexhinf.pages.page import design_statuses, files_section
from flexhinf.pages.settings import comparison_settings, damping_text
from flexhinf.report import (
    Badge,
    Cell,
    Column,
    Figure,
    KeyNumber,
    Note,
    Page,
    PageBlock,
    Paragraph,
    Provenance,
    Section,
    Settings,
    Table,
    finite,
)
from flexhinf.report.blocks import WIDTH
from flexhinf.robot.springs import DAMPED

if TYPE_CHECKING:
    from rich.table import Table as Terminal

#: What a law needs of the state, in the order of the model.
SIGNALS = ("link_position", "link_velocity", "motor_position", "motor_velocity")

#: A hyphen at which no line breaks.
NO_BREAK = "\u2011"

#: Sections that are open at first.
OPEN = ("criterion", "responses")

#: An rms of noise at the motors from which all laws have it in V or A, and not in mV or mA.
LARGE_NOISE = 10.0

#: Times the peak input of the design as it is: a law with more wins by inputs that nothing limits.
UNLIMITED = 5.0

#: Differences of the criterion smaller than this fraction say nothing: two searches of one law end so far apart.
EQUAL = 0.1


# Verdict -----------------------------------------------------------------------------------------------------
def tuned_laws(comparison: Comparison) -> list[TunedLaw]:
    """Every law that is compared, the design's own first."""
    return [row.tuned for row in comparison.compared if row.tuned is not None]


def best_hinf_law(comparison: Comparison) -> TunedLaw:
    """The best nonlinear H∞ law that keeps every limit, the design as it is among them; the best of all where none
    does."""
    laws = (law for law in tuned_laws(comparison) if is_hinf(law.name))
    return min(laws, key=lambda law: (bool(law.missed), law.cost))


def nearest_rival(comparison: Comparison) -> TunedLaw | None:
    """The best rival; where none keeps every limit, that with the smallest criterion; None where none could be made."""
    laws = [law for law in tuned_laws(comparison) if not is_hinf(law.name)]
    return best_rival(laws) or min(laws, key=lambda law: law.cost, default=None)


def is_ranked(comparison: Comparison) -> bool:
    """Whether a rival and a nonlinear H∞ law keep every limit, so that the one can be ranked against the other."""
    rival = nearest_rival(comparison)
    return rival is not None and not rival.missed and not best_hinf_law(comparison).missed


def _whole(text: str) -> str:
    for name in sorted((n for n in LAWS if "-" in n), key=len, reverse=True):
        text = text.replace(name, name.replace("-", NO_BREAK))
    return text


def comparison_verdict(comparison: Comparison) -> str:
    """The best rival against nonlinear H∞, both tuned alike; where ours loses, the first sentence says so."""
    laws, own_law, rival = tuned_laws(comparison), best_hinf_law(comparison), nearest_rival(comparison)
    name = "the design" if own_law.name == DESIGN else own_law.name
    if rival is None:
        return f"No other law could be compared with {name}."
    if not is_ranked(comparison):
        return _unranked(own_law, rival, name)
    costs = f"{number(rival.cost, 3)} against {number(own_law.cost, 3)}; less is better"
    nothing = "so by this criterion nonlinear H∞ buys nothing on this robot."
    if rival.cost < own_law.cost * (1.0 - EQUAL):
        text = f"The best rival, {rival.name}, beats {name} by the criterion ({costs}), {nothing}"
    elif rival.cost <= own_law.cost * (1.0 + EQUAL):
        text = (
            f"Between the best rival, {rival.name}, and {name} there is no difference that the search can tell "
            f"({costs}), {nothing}"
        )
    else:
        text = f"The best rival, {rival.name}, loses to {name} by the criterion ({costs})."
    text = f"{text} {unlimited_text(comparison)}".rstrip()
    better = [
        f"{law.name} ({number(law.cost, 3)})"
        for law in ranked(laws)
        if law is not rival and not is_hinf(law.name) and law.cost < own_law.cost * (1.0 - EQUAL)
    ]
    if better:
        text += f" Better than {name} {'is' if len(better) == 1 else 'are'} also {', '.join(better[:3])}."
    theirs, mine = (comparison.criterion.ratios(law.metrics) for law in (rival, own_law))
    *parts, last = [f"{number(theirs[key] / mine[key], 3)} times the {what}" for key, what in RATIOS.items()]
    text += f" Relative to {name}, {rival.name} has {', '.join(parts)} and {last}."
    design = comparison.own.tuned
    if design is not None and own_law is not design:
        text += f" The design as it is, not tuned for the criterion, has {number(design.cost, 3)}."
    return text


def unlimited_text(comparison: Comparison) -> str:
    """That no motor has a limit, and what a law then asks of one; "" where limits hold, or no law makes use of it."""
    if _limited(comparison):
        return ""
    peaks = {
        row.name: row.evaluation.metrics.get("step_peak_input")
        for row in comparison.compared
        if row.evaluation
    }
    design, most = peaks.get(DESIGN), max(peaks, key=lambda name: peaks[name] or 0.0, default=DESIGN)
    if not design or not (peaks[most] or 0.0) > UNLIMITED * design:
        return ""
    unit = comparison.units()["input"]
    large, usual = (
        f"{number(size / 1e3, 3)} k{unit}" if size >= 1e3 else f"{number(size, 3)} {unit}"
        for size in (peaks[most] or 0.0, design)
    )  # fmt: skip
    return (
        f"The laws are ranked by inputs that no motor limits: {most} takes {large} in the step, the design as it is "
        f"takes {usual}. To try: --peak-effort, with what a motor gives."
    )


def _limited(comparison: Comparison) -> bool:
    return any(limit.metric == "noise_percent" for limit in comparison.criterion.limits)


def _unranked(own_law: TunedLaw, rival: TunedLaw, name: str) -> str:
    """The verdict where a rival, nonlinear H∞ or both miss a limit: what each has, and what it misses."""
    costs = f"{rival.name} has {number(rival.cost, 3)} by the criterion, {name} {number(own_law.cost, 3)}"
    if rival.missed and own_law.missed:
        text = "No law keeps every limit of the tuning, so none is ranked."
    elif rival.missed:
        text = f"No other law keeps every limit of the tuning, so none is ranked against {name}."
    else:
        text = (
            f"The best rival, {rival.name}, keeps every limit of the tuning, and {name} does not, so by these limits "
            "nonlinear H∞ buys nothing on this robot."
        )
    missed = [
        f"{what} misses: {law.missed}." for law, what in ((rival, rival.name), (own_law, name)) if law.missed
    ]
    return " ".join([text, f"{costs}; less is better.", *missed])


# Page --------------------------------------------------------------------------------------------------------
def comparison_page(
    comparison: Comparison, command: Sequence[str], warnings: Sequence[str] = (), files: Sequence[str] = (),
    verdict: DesignVerdict = UNKNOWN,
) -> Page:  # fmt: skip
    """The page of a comparison; parameters as for `flexhinf.pages.page.design_page`, and the verdict on the design."""
    own, s, robot = comparison.own.evaluation, comparison.specification, comparison.robot
    assert own is not None
    start, goal = (
        pose_text(pose, robot.links.slides, s.in_degrees) for pose in (own.setup.start, own.setup.goal)
    )
    trade_off, ordered = trade_off_figure(comparison, tuned_laws(comparison)), ordered_laws(comparison)
    said = [f"{part.rstrip('.')}." for part in comparison_verdict(comparison).split(". ")]
    sections = [Section(title, tuple(parts), anchor, anchor in OPEN) for (anchor, title), parts in {
        ("criterion", "Laws by the criterion"): (
            Table(
                ("limit for every law", "value", "stated by"),
                [
                    (x.label.rstrip(","), f"{'≥' if x.at_least else '≤'} {number(x.value, 3)} {x.unit}".strip(),
                     x.origin)
                    for x in comparison.criterion.limits
                ],
                id="table-limits",
            ),
            Paragraph(
                "The four columns of ratios are over those of the design as it is; the criterion is their geometric "
                "mean, and less is better; differences of less than 10 % say nothing. The limits are those of the "
                "specification; 2 % past one count as kept. A law that misses one, or has an unstable corner of the "
                "tolerances, is not ranked: its row and its curves are of the tuning that exceeds the limits least."
            ),
            _ranking(comparison),
            *map(Note, (*comparison_notes(comparison), *(" ".join(text.split()) for text in warnings))),
        ),
        ("figures", "Every metric of every law"): (metric_table(comparison, comparison.compared),),
        ("responses", "Step, load and move"): (responses_figure(comparison),),
        ("trade-off", "Trade-off"): () if trade_off is None else (trade_off,),
        ("frequency", "Frequency responses"): _frequency(comparison),
        ("laws", "The laws and how they were tuned"): _laws(comparison),
    }.items() if parts]  # fmt: skip
    return Page(
        f"Control laws compared on {robot.name}",
        f"{robot.name}, {joint_count(len(own.setup.joints))}, {robot.drive} driven; step from {start} to {goal}. "
        "All laws are for this goal alone; flexhinf design without a pose makes one for the workspace. "
        f"{count_text(len(comparison.compared), 'law')} with the same commands, load, move, robots, seeds and limits. "
        f"“{DESIGN}” is the law as flexhinf design makes it (preset {comparison.synthesis.design_problem.preset}, "
        f"{law_name(comparison.synthesis.chosen.degree)}, {ESTIMATED_BY[s.estimator]}); {_whole(NL_HINF)} is the same "
        f"problem tuned as the other laws are. Criterion: {comparison.criterion.measure}",
        _whole(said[0]),
        (*sections, *([files_section(files)] if files else [])), Settings(comparison_settings(comparison)),
        Provenance(shlex.join(command), s.seed), _key_numbers(comparison),
        [
            *_status(comparison, said[0], verdict),
            Badge("not proved", "All numbers are of simulated runs, of sampled robots and of the linear loop."),
        ],
        list(map(_whole, said[1:])), [ranking_figure(comparison, ordered), *arms_of(comparison, ordered)],
    )  # fmt: skip


def comparison_design(comparison: Comparison) -> str:
    """What the design as it is misses of the requirements that every law is judged by; a design has more."""
    lines, own = comparison.own.requirements, comparison.own.evaluation
    degrees = own is not None and units_of(own).degrees
    missed = [line.converted(degrees).text for line in lines if line.missed]
    if not missed:
        return f"The design as it is meets the {len(lines)} requirements judged here; flexhinf design judges more."
    judged = f"{len(missed)} of the {len(lines)} requirements judged here"
    return f"The design as it is does not meet {judged}: {'; '.join(missed)}."


def _status(comparison: Comparison, text: str, verdict: DesignVerdict) -> list[Badge]:
    """Whether the laws could be ranked, and what the design as it is misses; “met” only where neither is wanting."""
    statuses = [] if is_ranked(comparison) else [Badge("risky", f"Not ranked: {text}")]
    if unlimited := unlimited_text(comparison):
        statuses.append(Badge("risky", unlimited))
    beyond = [
        f"{row.name} ({count})"
        for row in comparison.rows
        if row.name != DESIGN and row.tuned is not None and not row.tuned.missed
        if (count := sum(line.missed for line in row.requirements))
    ]
    if beyond:
        laws_text = ", ".join(beyond)
        statuses.append(
            Badge("risky", f"Within the limits of the tuning, other requirements are missed: {laws_text}.")
        )
    if any(line.missed for line in comparison.own.requirements):
        if not verdict.missed:  # which would name more of them
            statuses.append(Badge("not met", comparison_design(comparison)))
    elif not statuses and not verdict.missed:
        laws = ordered_laws(comparison)
        kept = f"{sum(kept for _, kept in laws)} of {count_text(len(laws), 'law')} keep every limit of the tuning"
        statuses.append(Badge("met", f"{kept}. {comparison_design(comparison)}"))
    return [*statuses, *(design_statuses(verdict) if verdict.names else [])]


def comparison_notes(comparison: Comparison) -> list[str]:
    """Limits of the comparison that the reader must know."""
    notes, own, s = list[str](), comparison.own.evaluation, comparison.specification
    for row in comparison.rows:
        if row.failure:
            notes.append(f"{row.name} was not compared: {row.failure.rstrip('.')}.")
        if row.tuned is not None and row.tuned.missed:
            tried = f" with any of {row.tuned.candidates} tunings" if row.tuned.candidates else ""
            notes.append(f"{row.name} is not ranked, as it does not keep{tried}: {row.tuned.missed}.")
        if row.evaluation is not None and row.evaluation.linear_failure:
            notes.append(
                f"The loop of {row.name} could not be linearised: {row.evaluation.linear_failure.rstrip('.')}."
            )
    compared = {row.name for row in comparison.rows}
    if others := [name for name in rivals(comparison.robot.drive) if name not in compared]:
        notes.append(f"Not asked for, and so not compared: {', '.join(others)}.")
    if own is not None and own.setup.left_out:
        names = " and ".join(own.setup.left_out).replace("_", " ")
        notes.append(f"The linear loops leave out {names}, as in flexhinf design; the runs have it.")
    if own is not None and DAMPED in own.setup.extras:
        notes.append(damping_text(comparison.robot))
    if not _limited(comparison):
        notes.append(
            "No motor has a limit, so neither the peak input nor the noise at the motors limits a law; --peak-effort "
            "states one."
        )
    if comparison.synthesis.chosen.degree == 2 and any(row.name == "hinf" for row in comparison.compared):
        notes.append("The design chose degree 2: it is a linear law, as hinf is.")
    if s.via:
        notes.append("The design switches between laws of several poses; all else is of the one at the goal.")
    return notes


# Sections --------------------------------------------------------------------------------------------------
def ordered_laws(comparison: Comparison) -> list[tuple[TunedLaw, bool]]:
    """The laws by their criterion, those that miss a limit last, and whether each keeps every limit."""
    ordered = sorted(tuned_laws(comparison), key=lambda law: (bool(law.missed), law.cost))
    return [(law, not law.missed) for law in ordered]


def _ranking(comparison: Comparison) -> Table:
    ordered = ordered_laws(comparison)
    return Table(
        (
            "law", *(Column(name, "", 2) for name in ("criterion", *RATIOS.values())), "unstable corners", "measured",
            "ranked, or what it misses",
        ),
        [
            (
                _whole(f"{law.name}, as it is" if law.name == DESIGN else law.name),
                *finite([law.cost, *(ratios[name] for name in RATIOS)]),
                "–" if law.evaluation.corners is None else law.evaluation.corners.unstable,
                ", ".join(law.sensors).replace("_", " ") or "true state",
                f"no: {law.missed}" if law.missed else "the unit" if law.name == DESIGN else "yes",
            )
            for law, _ in ordered
            for ratios in (comparison.criterion.ratios(law.metrics),)
        ],
        "", "table-criterion", stacks=True,
    )  # fmt: skip


def _frequency(comparison: Comparison) -> list[Figure]:
    laws = [law for law in tuned_laws(comparison) if not law.evaluation.linear_failure]
    always = [law for law in laws if law.name in (DESIGN, NL_HINF)]  # and the best others by the criterion
    others = sorted((law for law in laws if law.name not in (DESIGN, NL_HINF)), key=lambda law: law.cost)[:3]
    place = {row.name: k for k, row in enumerate(comparison.rows)}  # a law looks the same in every figure
    loops = [LoopLine(a.name, a.evaluation.frequency_response, place[a.name]) for a in always + others]
    assert comparison.own.evaluation is not None
    units, joints = units_of(comparison.own.evaluation), comparison.robot.joint_names
    return frequency_figures(loops, joints, [units.of(units.compliance, joint) for joint in joints])


def _key_numbers(comparison: Comparison) -> list[KeyNumber]:
    rival, own_law = nearest_rival(comparison), best_hinf_law(comparison)
    numbers: list[KeyNumber] = []
    metrics = {metric.key: metric for group in METRICS.values() for metric in group}
    called = "the design" if own_law.name == DESIGN else _whole(own_law.name)
    theirs_called = "" if rival is None else f"{_whole(rival.name)}{' (not ranked)' if rival.missed else ''}"
    for key in (
        "load_deviation", "step_settling_s", "move_error", "load_remaining", "peak_sensitivity", "unstable_corners",
        "input_noise",
    ):  # fmt: skip
        values = [None if law is None else law.evaluation.metrics.get(key) for law in (own_law, rival)]
        mine, theirs = (cell(metrics[key], value, comparison) for value in values)
        if values[0] is not None:
            name, unit = f"{called}: {metrics[key].label}", unit_of(metrics[key], comparison)
            numbers.append(KeyNumber(name, mine, unit, "" if rival is None else f"{theirs_called}: {theirs}"))
    return numbers


def _laws(comparison: Comparison) -> list[PageBlock]:
    rows: list[Sequence[object]] = []
    for row in comparison.rows:
        tuned, kind = row.tuned, row.kind
        labels = {p.name: (p.label, p.unit) for p in kind.parameters}
        stated: Mapping[str, float] = {} if tuned is None else tuned.parameters
        named = ((*labels.get(name, (name.replace("_", " "), "")), value) for name, value in stated.items())
        parts = [f"{what} {number(value, 3)} {unit}".strip() for what, unit, value in named]
        states = () if row.evaluation is None else row.evaluation.needed_states
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
            "–" if tuned is None else ", ".join(tuned.sensors).replace("_", " ") or "–",
            ", ".join(needs) or "–", kind.model, kind.source,
        ))  # fmt: skip
    return [
        Paragraph(
            "Every law but the design as it is, is tuned over all its parameters and the noise levels of its "
            "estimator, in three rounds with as many candidates per parameter, with the sensors that its proponents "
            "would choose. The step begins as it would be deployed: the input continues from what held the robot, by "
            "the integrals, and by a bias that fades within the run where a law has none. The move is followed in "
            "error coordinates, (x_d, u_d) from the elastic inverse dynamics."
        ),
        Table(
            ("law", "what it is", "tuned", "candidates", "measured", "needs of the state", "knows", "source"),
            rows,
            stacks=True,
        ),
    ]


class LawMetric(NamedTuple):
    """A metric of a law, by its key of `LawEvaluation.metrics`.

    `unit` "input" is V or N·m; shown in thousandths are "small input", "length" (of rad or m) and "ms" (of s).
    `better`: −1 where less is better, 1 where more is, 0 for neither. `resolution`: smallest difference that counts,
    in the unit of the value. `brief`: whether a terminal shows it too.
    """

    key: str
    label: str
    unit: str
    better: int = -1
    resolution: float = 0.0
    brief: bool = True


#: Metrics in the order of the table, by the titles of their groups where there is little room.
METRICS = {
    "step as deployed": (
        LawMetric("step_peak_input", "peak input", "input"),
        LawMetric("step_overshoot_percent", "overshoot", "%", resolution=0.5),
        LawMetric("step_settling_s", "settling time", "s", resolution=0.01),
        LawMetric("step_remaining", "remaining error", "length", resolution=1e-4),
    ),
    "torque on the links": (
        LawMetric("load_deviation", "largest deviation", "length"),
        LawMetric("load_recovery_s", "recovered after", "s", resolution=0.01),
        LawMetric("load_remaining", "remaining deviation", "length", resolution=1e-4),
    ),
    "planned move": (
        LawMetric("move_error", "largest error", "length", resolution=1e-4),
        LawMetric("move_remaining", "remaining error", "length", resolution=1e-4, brief=False),
        LawMetric("move_peak_input", "peak input", "input"),
    ),
    "sampled robots": (
        LawMetric("drawn_unsettled", "steps not settled", "", resolution=0.5),
        LawMetric("drawn_overshoot_percent", "median overshoot", "%", resolution=0.5, brief=False),
        LawMetric("drawn_worst_overshoot_percent", "worst overshoot", "%", resolution=0.5),
        LawMetric("drawn_settling_s", "median settling time", "s", resolution=0.01, brief=False),
        LawMetric("drawn_worst_settling_s", "worst settling time", "s", resolution=0.01),
        LawMetric("drawn_worst_peak_input", "worst peak input", "input", brief=False),
        LawMetric("drawn_move_error", "median move error", "length", resolution=1e-4, brief=False),
        LawMetric("drawn_worst_move_error", "worst move error", "length", resolution=1e-4),
    ),
    "running loop, linearised": (
        LawMetric("unstable_corners", "unstable corners", "", resolution=0.5),
        LawMetric("peak_sensitivity", "peak sensitivity", "", resolution=0.01),
        LawMetric("gain_margin", "gain margin, ×", "", 1, 0.01),
        LawMetric("delay_margin_s", "delay margin", "ms", 1),
        LawMetric("damping", "smallest damping ratio", "", 1, 0.0005),
        LawMetric("input_noise", "input noise, rms", "small input"),
        LawMetric("bandwidth_rad_s", "bandwidth", "rad/s", 0, brief=False),
    ),
    "cost": (LawMetric("operations", "operations per sample", ""),),
}


def unit_of(metric: LawMetric, comparison: Comparison) -> str:
    """Unit of a metric as it is printed."""
    units, own = comparison.units(), comparison.own.evaluation
    if metric.key == "drawn_unsettled":
        return f"of {len(comparison.scenario.robots)}"
    if metric.key == "unstable_corners" and own is not None and own.corners is not None:
        return f"of {own.corners.count}"
    assert own is not None
    small = f"{_prefix(metric, comparison)[0]}{units['input']}"
    return {"input": units["input"], "small input": small, "length": small_of(units_of(own))[0]}.get(
        metric.unit, metric.unit
    )


def _with_unit(text: str, metric: LawMetric, law: ComparedLaw) -> str:
    """A value with the unit of its joint, where joints turn and slide and the joint is known."""
    e, small = law.evaluation, ""
    if e is not None and metric.unit == "length" and metric.key in e.worst:
        small = small_of(units_of(e))[0]
    if e is None or " or " not in small or not text[:1].isdigit():
        return text
    return f"{text} {units_of(e).of(small, e.worst[metric.key].joint)}"


def _prefix(metric: LawMetric, comparison: Comparison) -> tuple[str, float]:
    """Prefix of the unit of a small input, one for all laws, and the factor to it: none where a law has 10 units."""
    values = (
        row.evaluation.metrics.get(metric.key) for row in comparison.compared if row.evaluation is not None
    )
    large = any(value is not None and np.isfinite(value) and abs(value) >= LARGE_NOISE for value in values)
    return ("", 1.0) if large else ("m", 1e3)


def cell(metric: LawMetric, value: float | None, comparison: Comparison) -> str:
    """Value of a metric as text, without its unit."""
    if value is None:
        return "–"
    if np.isinf(value):
        if "settling" in metric.key:
            return f"> {comparison.scenario.step_duration:g}"
        return "never" if metric.key == "load_recovery_s" else "∞" if metric.better > 0 else "diverges"
    assert comparison.own.evaluation is not None
    value *= {"length": small_of(units_of(comparison.own.evaluation))[1], "ms": 1e3}.get(metric.unit, 1.0)
    if metric.unit == "small input":
        value *= _prefix(metric, comparison)[1]
    if metric.unit == "%":
        return number(value, decimals=1)
    if abs(value) >= 1e3 or (not metric.unit and value == round(value)):
        return number(round(value))
    if 0.0 < abs(value) < 1e-2:
        return number(value, 2)
    return number(value, decimals=int(np.clip(2 - np.floor(np.log10(abs(value) or 1.0)), 0, 3)))


def best_of(metric: LawMetric, values: Sequence[float | None]) -> tuple[bool, ...]:
    """Which values are the best or as good; none where all are alike."""
    known, best = [value for value in values if value is not None], [False for _ in values]
    if metric.better and len(known) > 1:
        top = min(known) if metric.better < 0 else max(known)
        width = max(0.005 * abs(top), metric.resolution) if np.isfinite(top) else 0.0  # both are as good
        best = [value is not None and (value == top or abs(value - top) <= width) for value in values]
    return tuple(tied and sum(best) < len(known) for tied in best)


def metric_table(
    comparison: Comparison, laws: Sequence[ComparedLaw], short: bool = False, title: str = ""
) -> Table:
    """Metrics of some laws, each with an evaluation: one column for each law; the best of a row is that of all laws.
    `short` and `title` are for a terminal."""
    own, s, scenario = comparison.own.evaluation, comparison.specification, comparison.scenario
    assert own is not None
    start, goal = (
        pose_text(pose, comparison.robot.links.slides, s.in_degrees)
        for pose in (comparison.synthesis.start, comparison.synthesis.goal)
    )
    torques = ", ".join(number(float(value), 3) for value in scenario.load)
    over = "the same way" if s.move is None else "the stated waypoints"
    titles = {  # on a page, of the groups of `METRICS`
        "step as deployed": f"Step {start} → {goal} as the controller is deployed, the run of flexhinf design",
        "torque on the links": f"Torque of {torques} {comparison.units()['torque']} on the links, at the goal",
        "planned move": f"Planned move of {number(float(scenario.plan.duration), 3)} s over {over}, with feedforward",
        "sampled robots": f"{len(scenario.robots)} robots sampled within their tolerances: step and move",
        "running loop, linearised": "Running loop, linearised at the goal, with its estimator and delay",
        "cost": "Cost",
    }
    eligible = [law.name for law in comparison.compared if law.tuned is not None and not law.tuned.missed]
    costs = (law.tuned.cost if law.tuned else np.nan for law in laws)
    rows: list[Sequence[object]] = [
        "criterion" if short else "Criterion and limits",
        ("criterion, design = 1", *(number(c, 3) if np.isfinite(c) else "diverges" for c in costs)),
        ("keeps every limit of the tuning", *("yes" if law.name in eligible else "no" for law in laws)),
    ]
    judged = [{(line.what, line.where): line for line in law.requirements} for law in laws]
    for key, first in {key: line for law in judged for key, line in law.items()}.items():
        sampled = ", sampled" if "robots sampled" in first.where else ""
        name = f"{first.what} {first.converted(units_of(own).degrees).limit_text}{sampled}"
        rows.append((name, *(law[key].judgement if key in law else "–" for law in judged)))
    for heading, group in METRICS.items():
        entries: list[Sequence[object]] = []
        for metric in (metric for metric in group if metric.brief or not short):
            values = {law.name: law.metrics.get(metric.key) for law in comparison.compared}
            if set(values.values()) == {None}:
                continue
            kept = {name: values[name] for name in eligible}
            best = dict(zip(kept, best_of(metric, list(kept.values()))))
            texts = [_with_unit(cell(metric, values[law.name], comparison), metric, law) for law in laws]
            cells = (Cell(text, "best" if best.get(law.name) else "") for text, law in zip(texts, laws))
            entries.append((", ".join(filter(None, (metric.label, unit_of(metric, comparison)))), *cells))
        rows += [heading if short else titles[heading], *entries] if entries else []
    return Table(
        ("", *(Column(law.name.replace("-", NO_BREAK), brief=law.name, right=True) for law in laws)), rows,
        "The same commands, load, move, robots and seeds for all. “best”: in its row, of the laws that keep every "
        "limit, or as good", "figures-of-merit",
        title=title,
    )  # fmt: skip


def comparison_tables(comparison: Comparison, width: int = WIDTH) -> list[Terminal]:
    """Tables for a terminal of `width` columns, as many laws as fit, the design's own in each; * marks the best."""
    from rich.console import Console

    parts: list[Terminal] = []
    first, legend = comparison.tuned_design, "* best of its row, or as good as the best"
    title = f"{comparison.robot.name}: laws in the same runs; {legend}"
    order = [comparison.row(law.name) for law, _ in ordered_laws(comparison)]
    part, table = [first], metric_table(comparison, [first], True, title).terminal(wide=True)
    for law in (law for law in order if law is not first):
        wider = metric_table(comparison, [*part, law], True, title).terminal(wide=True)
        if len(part) > 1 and Console(width=10 * width).measure(wider).maximum > width:
            parts.append(table)
            part, title = [first], legend
            wider = metric_table(comparison, [first, law], True, title).terminal(wide=True)
        part, table = [*part, law], wider
    return [*parts, table]
