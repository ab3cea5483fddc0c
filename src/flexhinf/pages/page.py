"""The report of a design: one page (status, requirements, runs, margins, corners, weights, region, law), every setting
with who states it, the list of files, and tables for a terminal."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, NamedTuple, TypedDict

import numpy as np

from flexhinf.designs.pose_evidence import PoseEvidence
from flexhinf.designs.requirements import Requirement
from flexhinf.designs.requirements.requirement import TOLERANCE
from flexhinf.designs.responses import Response
from flexhinf.designs.specification import Specification
from flexhinf.designs.verdict import DesignVerdict
from flexhinf.files import write_file
from flexhinf.loop.simulation.metrics import peak_of
from flexhinf.numerals import count_text, number
from flexhinf.pages.design import frequency, law, overview, region, runs, step, weights
from flexhinf.pages.drawing import (
    Blocks,
    in_joint,
    joint_count,
    law_name,
    note,
    pose_text,
    range_text,
    rounded,
    units_of,
)
from flexhinf.pages.settings import design_settings
from flexhinf.report import (
    Badge,
    Cell,
    Column,
    Fact,
    Note,
    Page,
    Paragraph,
    Section,
    Table,
    house_style,
    to_json,
    with_figures,
)
from flexhinf.robot import catalogue, load_robot
from flexhinf.robot.actuators import published_gears, published_joints
from flexhinf.robot.gears import CURVE

if TYPE_CHECKING:
    from rich.table import Table as Terminal

#: Kinds of requirements that a sentence names.
BRIEF = 6


# Requirements: limit, achieved value, place and criterion; then the inputs of the motors ---------------------
def requirements(design: PoseEvidence) -> Blocks:
    """Table of the requirements, those that are not met first, and of the inputs."""
    units = units_of(design.evaluation)
    yield requirement_table(
        design.requirements,
        units.degrees,
        f"{design.robot.name}: requirements (* our default; a miss of {100.0 * TOLERANCE:g} % counts as met)",
    )
    if design.design_problem.target is None:
        yield Paragraph(
            "No bandwidth is required, and of damping only what every loop needs: they result from the given weights."
        )
    limits, rows = design.setup.limits, list[Sequence[object]]()
    several, limited = len(design.setup.joints) > 1, limits.limits_effort
    for row in input_rows(design):
        limit = float(limits.effort[limits.joints.index(row["joint"])]) if row["joint"] else np.inf
        known = np.isfinite(row["value"])
        more = ([row["joint"] or "–"] if several else []) + (
            [100.0 * row["value"] / limit if known and np.isfinite(limit) else None] if limited else []
        )
        rows.append((row["what"], f"{number(row['value'], 3)} {row['unit']}" if known else "diverges", *more))
    bound = f"; the limit is {units.effort_text(limits.effort)}" if limited else ""
    yield Table(
        (
            "in",
            "input nearest its limit" if len(set(limits.effort.tolist())) > 1 else "largest input",
            *(["joint"] if several else []),
            *([Column("of its limit", "%", 1, brief=None)] if limited else []),
        ),
        rows,
        f"Inputs of the motors{bound}",
        "table-cost",
        title="Inputs of the motors",
    )


def requirement_table(lines: Iterable[Requirement], degrees: bool = False, title: str = "") -> Table:
    """Requirements grouped by where they hold; those that are not met or not judged, and their groups, first."""
    groups: dict[str, list[Requirement]] = {}
    for line in sorted(lines, key=lambda line: (not line.missed, line.met)):
        groups.setdefault(line.where, []).append(line.converted(degrees))
    rows: list[Sequence[object]] = []
    for where, group in groups.items():
        rows.append(where)
        for line in group:
            judged = Cell(line.judgement, {"met": "green", "NOT MET": "red"}.get(line.judgement, "yellow"))
            source = f"`{line.stated_by}`" if line.stated_by.startswith("--") else line.stated_by
            limit = line.limit_text
            if source == "default":
                source, limit = "our default", f"{limit}*"
            rows.append((line.what, limit, line.achieved_text, judged, line.criterion, source))
    return Table(
        (
            "requirement",
            Column("required", right=True),
            Column("achieved", right=True),
            "met",
            Column("criterion", brief=None),
            Column("stated by", brief=None),
        ),
        rows,
        f"A limit that is missed by at most {100.0 * TOLERANCE:g} % of it, the accuracy of the searches, counts as "
        "met, and the line says so. * our default",
        "table-specification",
        stacks=True,
        title=title,
    )


class InputRow(TypedDict):
    """The largest input of a run, its unit and joint; no joint where the run diverged."""

    what: str
    value: float
    joint: str
    unit: str


def input_rows(design: PoseEvidence) -> list[InputRow]:
    """The largest inputs of every run, until it diverged where it did: "what", "value", "joint", "unit"."""
    e, setup, samples = design.evaluation, design.setup, design.evaluation.step_samples
    runs: tuple[tuple[str, Response | np.ndarray | None], ...] = (
        ("equilibrium at the start", setup.equilibrium(design.start)[1]),
        ("equilibrium at the goal", setup.equilibrium(design.goal)[1]),
        ("step, nominal robot", e.step),
        (
            f"step, worst of {0 if samples is None else len(samples)} sampled robots",
            samples.inputs if samples is not None and len(samples) else None,
        ),
        ("step on MuJoCo's plant", design.mujoco),
        (f"planned move{' with feedforward' * e.setup.specification.feedforward}", e.move.response),
        ("load response: torques on the links", e.load_response.response),
        ("sensor noise in equilibrium (rms)", e.input_noises),
    )
    rows, effort = list[InputRow](), setup.limits.effort
    for what, run in ((what, run) for what, run in runs if run is not None):
        inputs = run.inputs if isinstance(run, Response) else np.asarray(run, dtype=float)
        cut = " (until it diverged)" if isinstance(run, Response) and run.diverged_at is not None else ""
        sizes = peak_of(inputs.reshape(-1, len(setup.joints)))
        worst = int(np.argmax(sizes / effort) if np.isfinite(effort).any() else np.argmax(sizes))
        value, unit = float(sizes[worst]), setup.model.unit(setup.model.inputs[worst])
        joint = setup.joints[worst] if np.isfinite(value) else ""
        rows.append({"what": f"{what}{cut}", "value": value, "joint": joint, "unit": unit})
    return rows


class Part(NamedTuple):
    """A section: its title, the function of its blocks, notes first, which makes none where the section does not
    apply; whether it is open at first, and the heading that it begins in the contents."""

    title: str
    blocks: Callable[[PoseEvidence], Blocks]
    open: bool = False
    group: str = ""


#: Sections by their anchors, in the order of the page. Runs, margins and what is for experts are folded.
PARTS = {
    "specification": Part("Requirements", requirements, True),
    "step": Part("Step response", step.step, True),
    "draws": Part("Robots within their tolerances", step.samples),
    "load": Part("Load response", runs.load, group="Other runs"),
    "payload": Part("Payload", runs.payload),
    "ring-down": Part("Ring-down after an impulse", runs.ring_down),
    "move": Part("Planned move", runs.move),
    "rest": Part("Long run at rest", runs.long_run),
    "along": Part("Margins along the move", runs.margins_along, group="Robustness"),
    "margins": Part("Margins of the running loop", frequency.margins),
    "modes": Part("Poles", law.poles),
    "corners": Part("Corners of the tolerances", frequency.corners),
    "weights": Part("Weights", weights.weights, group="Law and proof"),
    "noise": Part("Noise levels of the estimator", weights.noise_levels),
    "region": Part("Region: proved, sampled, dissipation", region.region),
    "law": Part("The law", law.law),
}


def design_page(
    design: PoseEvidence, command: Sequence[str], warnings: Sequence[str] = (), files: Sequence[str] = ()
) -> Page:
    """The page of a design with all its sections, settings and notes.

    `command` makes the report again, `warnings` are about the robot's file, and `files` stand beside the page.
    """
    robot, s, sections = design.robot, design.specification, list[Section]()
    about = f"{robot.description.rstrip('.')}. " if robot.description else ""
    measured = ", ".join(s.measured).replace("_", " ") if s.estimator != "none" else "the true state"
    extras = ", ".join(design.setup.extras).replace("_", " ")
    extras = f" The true plant also has {extras}." if extras else ""
    slides, degrees = robot.links.slides, units_of(design.evaluation).degrees
    start, goal = (pose_text(pose, slides, degrees) for pose in (design.start, design.goal))
    with house_style():  # once for all figures
        first = overview.lead(design)
        blocks_of = with_figures(*(part.blocks(design) for part in PARTS.values()))
    brief, group = overview.briefs(design), ""
    for (anchor, part), blocks in zip(PARTS.items(), blocks_of):
        group = part.group or group
        if anchor == "specification":
            blocks = [*(note(" ".join(text.split())) for text in warnings), *blocks]
        if not all(isinstance(block, Note) for block in blocks):
            about_it = brief.get(anchor, "")
            sections.append(Section(part.title, tuple(blocks), anchor, part.open, group, about_it))
            group = ""
    status, lines = design.status, design.requirements
    stepped = step.step_text(design.evaluation.step, units_of(design.evaluation))
    said = [f"{requirements_text(lines)} {controller_text(s, pose_task(goal))}.", stepped]
    defaults = "" if any(line.stated_by != "default" for line in lines) else ", all of them our defaults"
    met = [f"{len(lines)} of {len(lines)} requirements{defaults}"]
    if not any(line.what == "bandwidth" for line in lines):
        met.append("no bandwidth is required")
    kinds = {
        "met": [] if status.not_met else [*met, *filter(None, [status.scope])],
        "not met": status.not_met,
        "risky": status.risky,
        "not proved": status.not_proved,
    }
    texts = ((kind, "; ".join(part.rstrip(".") for part in parts)) for kind, parts in kinds.items())
    return Page(
        title_of(design),
        f"{about}{joint_count(len(robot.joint_names)).capitalize()}, {robot.drive} driven. Measured: {measured}."
        f"{extras} Step from {start} to {goal}.",
        " ".join(said if design.evaluation.step.diverged_at is None else reversed(said)),
        (*sections, *([files_section(files)] if files else [])),
        command,
        s.seed,
        design_settings(design.synthesis, design.evaluation),
        key_numbers(design),
        [Badge(kind, f"{text[:1].upper()}{text[1:]}.") for kind, text in texts if text],
        _details(design),
        first,
    )


def remarks(design: PoseEvidence) -> dict[str, list[str]]:
    """Limits and warnings that the reader must know, by the anchor of their section, in the order of the page."""
    return {
        anchor: [
            note.text
            for note in takewhile(lambda block: isinstance(block, Note), part.blocks(design))
            if isinstance(note, Note)
        ]
        for anchor, part in PARTS.items()
    }


def notes(design: PoseEvidence) -> list[str]:
    """The `remarks` as plain sentences, for a terminal and for design.json."""
    return [text.replace("`", "") for texts in remarks(design).values() for text in texts]


def verdict(design: PoseEvidence) -> str:
    """The status and what the loop does, in one paragraph for a terminal."""
    status, step_proof, e = design.status, design.step_proof, design.evaluation
    if not step_proof.proved:  # the headline says it in a sentence
        status = replace(
            status, not_proved=tuple(text for text in status.not_proved if text not in step_proof.missing)
        )
    parts = [status.line, scope_text(design), _headline(design)]
    if design.mujoco is not None:
        parts.append(f"On MuJoCo's plant: {step.difference_text(e.step, design.mujoco, units_of(e))}.")
    return " ".join(filter(None, parts))


def title_of(design: PoseEvidence) -> str:
    """Title of the report: what was designed, and for which robot."""
    name = law_name(design.chosen.degree)
    kind = f"A nonlinear H∞ law of {name}" if name.startswith("degree") else f"A {name} nonlinear H∞ law"
    kind = "A linear H∞ law" if design.chosen.degree == 2 else kind
    return f"{kind} for the robot “{design.robot.name}”"


def _headline(design: PoseEvidence) -> str:
    return " ".join((step.step_text(design.evaluation.step, units_of(design.evaluation)), *_details(design)))


def _details(design: PoseEvidence) -> list[str]:
    """What the loop does beside the step: vibrations, sampled robots, payloads, what is proved."""
    e, parts = design.evaluation, list[str]()
    if not e.margins.stable:
        parts.append("The sampled loop is unstable at the goal.")
    before, after = (law.vibration_damping(modes) for modes in (e.open_modes, design.law_modes))
    if after:
        parts.append(
            f"Damping ratio of the vibrations: {range_text(before, 2)} without control, {range_text(after, 2)} with "
            f"the law; smallest of the running loop, estimator included: {number(e.margins.damping, 2)}"
            f"{in_joint(e.least_damped_joint, e.setup.joints)}."
        )
    parts.append(sampled_text(design))
    if design.payloads:
        parts.append(runs.payload_text(design))
    return list(filter(None, [*parts, region.proof_text(design)]))


def design_statuses(verdict: DesignVerdict) -> list[Badge]:
    """Entries about the design at the top of the page of something that is made of it; none where it is met."""
    if verdict.missed:
        return [Badge("not met", f"{verdict.unmet}.")]
    return [] if verdict.met else [Badge("not judged", f"{verdict.brief}.")]


def controller_text(s: Specification, task: str) -> str:
    """Which law and estimator serve what task, as every page and terminal begins to say it."""
    return f"One controller (law {s.law}, estimator {s.estimator}) for {task}"


def pose_task(pose: str) -> str:
    """The task of one pose in words, with the option that states it."""
    return f"one pose, {pose} (--pose)"


def scope_text(design: PoseEvidence) -> str:
    """Law, estimator and pose of a design, and in which motions it was tested."""
    s, slides = design.specification, design.robot.links.slides
    goal = pose_text(design.goal, slides, units_of(design.evaluation).degrees)
    move = " and in the step to it" if s.move is None else ", in the step to it and in the stated move"
    return f"{controller_text(s, pose_task(goal))}, tested at rest there{move}."


def requirements_text(lines: Sequence[Requirement], of: str = "") -> str:
    """Whether the requirements are met, or the kinds of those that are not, and of those that are not judged.

    `of`: whose requirements they are, where the design has more.
    """
    texts: list[str] = []
    for verdict, some in {
        "Not met": [line for line in lines if line.missed],
        "Not judged, because the run ends too soon (--duration)": [line for line in lines if not line.judged],
    }.items():
        names = list(dict.fromkeys(line.what for line in some))
        named = ", ".join([*names[:BRIEF], *([f"and {len(names) - BRIEF} more"] if names[BRIEF:] else [])])
        texts += [f"{verdict}: {named}."] if some else []
    return " ".join(texts) or f"All {len(lines)} requirements{of and f' of {of}'} are met."


def sampled_text(design: PoseEvidence) -> str:
    """How many robots within their tolerances do not settle, or the worst numbers of those that do; or nothing."""
    samples = design.evaluation.step_samples
    if samples is None or not len(samples):
        return ""
    within = f"{len(samples)} robots sampled within their tolerances"
    if samples.unsettled:
        gone = f", {samples.diverged} of them diverge" if samples.diverged else ""
        return f"Of {within} {samples.unsettled} do not settle{gone}."
    effort = units_of(design.evaluation).effort
    return (
        f"All of {within} settle, the slowest in {_worst(design, 'settling', 's')}; the largest overshoot is "
        f"{_worst(design, 'overshoot', '%', 2)}, the largest input {_worst(design, 'peak', effort)}."
    )


def _worst(design: PoseEvidence, metric: str, unit: str, digits: int = 3) -> str:
    samples = design.evaluation.step_samples
    assert samples is not None
    values = getattr(samples, metric)
    joint = samples.joints[metric][int(np.argmax(values))]
    unit = units_of(design.evaluation).of(unit, joint)
    return f"{number(float(np.max(values)), digits)} {unit}{in_joint(joint, design.robot.joint_names)}"


def key_numbers(design: PoseEvidence) -> list[Fact]:
    """The numbers that matter most, of the nominal robot, with the worst of the sampled ones beside."""
    e, period, joints = design.evaluation, design.specification.period, design.evaluation.setup.joints
    response, m, samples, numbers = e.step, e.margins, e.step_samples, list[Fact]()
    for name, metric, value, joint, unit in (
        ("settling time", "settling", rounded(response.settling.value), response.settling.joint, "s"),
        ("overshoot", "overshoot", rounded(response.overshoot.value, 2), response.overshoot.joint, "%"),
        ("peak input", "peak", rounded(response.peak_input), response.peak.joint, units_of(e).effort),
    ):
        where, never = joint if len(joints) > 1 else "", metric == "settling" and value is None
        if samples is not None and len(samples):
            values = getattr(samples, metric)
            text = f"worst of {len(values)} robots: {_worst(design, metric, unit)}"
            if not np.isfinite(values).all():
                bad = "do not settle" if metric == "settling" else "diverge"
                text = f"{int(np.isinf(values).sum())} of {len(values)} sampled robots {bad}"
            where = "; ".join(filter(None, (where, text)))
        unit = "" if never else units_of(e).of(unit, joint)
        numbers.append(Fact(name, "not settled" if never else value, unit, where))
    if not m.stable:
        return [*numbers, Fact("margins", "none", note="the sampled loop at the goal is unstable")]
    low, high = m.disk_gain_margins
    numbers += [
        Fact("peak sensitivity", rounded(m.peak_sensitivity), note="running loop, with the estimator"),
        Fact(
            "gain margin",
            f"× {number(m.gain_margin, 3)}",
            note=f"one input{in_joint(joints[m.weakest_input], joints)}; all at once × {number(low, 2)} to "
            f"× {number(high, 3)}",
        ),
        Fact(
            "delay margin",
            rounded(1e3 * m.delay_margin_s),
            "ms",
            f"{number(m.delay_margin_s / period, 3)} periods of {number(1e3 * period, 3)} ms",
        ),
    ]
    if e.corners is not None:
        which = "all of the tolerances" if e.corners.complete else "sampled"
        numbers.append(Fact("unstable corners", e.corners.unstable, f"of {e.corners.count}", which))
    return numbers


# For a terminal of 80 columns --------------------------------------------------------------------------
def design_tables(design: PoseEvidence) -> list[Terminal]:
    """The tables of the page that have a title for a terminal, in its order; of the modes fewer rows."""
    return [
        (law.mode_table(design, brief=True) if table.id == "table-modes" else table).terminal()
        for part in PARTS.values()
        for table in part.blocks(design)
        if isinstance(table, Table) and table.title
    ]


def robots_table() -> Terminal:
    """Table of the catalogue: what each robot is, and how many of its numbers have a source."""
    rows: list[Sequence[object]] = []
    for name in catalogue():
        robot = load_robot(name)
        assumed = sum("assumption" in parameter.source for parameter in robot.parameters)
        numbers = f"{len(robot.parameters) - assumed} sourced\n{assumed} assumed"
        rows.append((name, len(robot.joint_names), robot.drive, numbers, robot.description))
    return Table(
        ("name", "joints", "drive", "numbers", ""),
        rows,
        "Robots that come with flexhinf: flexhinf design NAME",
    ).terminal()


def actuators_table() -> Terminal:
    """Table of the published joints: what is known of each, and by whom."""
    rows = [
        (
            name,
            "\n".join(f"{key} {number['value']:g}" for key, number in joint.numbers.items()),
            joint.about,
            "\n".join(joint.sources),
        )
        for name, joint in published_joints().items()
    ]
    title = "Published joints: actuator = NAME in a [[joint]] takes what it does not state"
    return Table(("name", "numbers", "", "source"), rows, title).terminal()


def gears_table() -> Terminal:
    """Table of the published gears: the names that share a curve, and the curve."""
    rows = dict[tuple[str, str], list[str]]()
    for name, gear in published_gears().items():
        curve = [f"{gear.numbers[key]['value']:g}" for key in CURVE]
        text = f"K {', '.join(curve[:3])} N·m/rad; T {', '.join(curve[3:])} N·m"
        rows.setdefault((text, gear.sources[0]), []).append(name)
    title = "Published gears: gear = NAME in a [[joint]] takes the stiffness curve that it does not state"
    table = [("\n".join(names), text, source) for (text, source), names in rows.items()]
    return Table(("name", "curve", "source"), table, title).terminal()


#: What a file is, by its name or its ending; the first that fits.
MEANING = (
    ("design.toml", "the request and its result; `flexhinf design design.toml` makes the design again"),
    ("controller", "the controller: `flexhinf.load_controller`"),
    ("certificate", "a proof: `flexhinf certify --check` checks it again"),
    ("certificate-tolerances", "a proof: `flexhinf certify --check` checks it again"),
    ("robot.toml", "the robot with the numbers of this page"),
    ("motion.csv", "the proposed motion, SI units, time in s"),
    (".json", "every number of this page"),
    ("estimate", "estimates, innovations and NIS at every sample, SI units, time in s"),
    (".csv", "one run, one column for each signal, SI units, time in s"),
    (".nc", "one run as NetCDF: `xarray.open_dataset`, units as attributes"),
)


def _names_text(names: Sequence[str]) -> str:
    """Names of files between backticks, numbered ones by the first and the last."""
    numbered = len({re.sub(r"\d+", "", name) for name in names}) == 1 and len(names) > 2
    return f"{names[0]}` to `{names[-1]}" if numbered else "`, `".join(names)


def files_section(files: Sequence[str]) -> Section:
    """Table of the files; those of one folder with the same meaning share a row."""
    grouped: dict[tuple[str, str], list[str]] = {}
    for name in sorted(
        files, key=lambda name: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", name)]
    ):
        path = PurePath(name)
        folder, _, file = name.rpartition("/")
        grouped.setdefault(
            (folder, next((text for key, text in MEANING if key in (name, path.suffix, path.stem)), "")), []
        ).append(file)
    rows = [
        (f"`{folder}{'/' if folder else ''}{_names_text(names)}`", meaning)
        for (folder, meaning), names in grouped.items()
    ]
    brief = count_text(len(files), "file")
    return Section(
        "Files beside this page", (Table(("file", "content"), rows, stacks=True),), "files", brief=brief
    )


def report_files(
    page: Page, numbers: str, others: Mapping[str, str | bytes] | None = None
) -> dict[str, str | bytes]:
    """The files of a report: the page, which lists the others, its numbers under this name, and the `others`."""
    files = {**(others or {}), numbers: to_json(page.numbers)}
    whole = replace(page, sections=(*page.sections, files_section([*files])))
    return {"index.html": whole.html(), **files}


def write_page(folder: Path, what: str, page: Page) -> Path:
    """Write index.html of a folder, whole or not at all; returns its path."""
    text, path = page.html(), folder / "index.html"
    write_file(path, what, lambda name: Path(name).write_text(text, encoding="utf-8"))
    return path
