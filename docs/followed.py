"""Numbers that are followed through the rooms, from where they come in to where they are read.

A row is a number; each step names a file, a function or class in it, and what the number is there. Of two steps one
names the other in its code, or both name what passes between them (`via`). `python docs/make.py followed` draws them;
a test finds a step that the code no longer takes.
"""

from __future__ import annotations

import ast
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape

PACKAGE = Path(__file__).resolve().parents[1] / "src" / "flexhinf"


class Step(NamedTuple):
    """A place where a number is."""

    file: str
    name: str  # of a function, a class, or a field of a class; Class.method
    what: str
    via: str = ""  # what the code of this step and of the next one has to name, where neither names the other


FOLLOWED = {
    "--bandwidth": (
        Step("designs/specification.py", "Specification.bandwidth", "unit, range, help", "bandwidth"),
        Step("designs/problem/presets.py", "_searched", "required of each joint"),
        Step("designs/problem/weights.py", "search", "weights that reach it", "target.bandwidth"),
        Step("designs/about_pose.py", "_requirements", "required, and reached"),
        Step("designs/judge.py", "bandwidth_requirement", "met, or not", "Requirement"),
        Step("pages/page.py", "requirement_table", "a line of the page"),
    ),
    "a tolerance": (
        Step("robot/robot.py", "Robot.corner", "an end of its range"),
        Step("robot/robot.py", "Robot.random_corners", "robots at corners"),
        Step("designs/workspace/samples.py", "corner_moves", "a move of each"),
        Step("designs/workspace/design.py", "judged_design", "all of these runs"),
        Step("designs/judge.py", "worst_move_requirements", "the worst, judged", "Requirement"),
        Step("pages/page.py", "requirement_table", "a line of the page"),
    ),
    "γ": (
        Step("hinf/linear_part.py", "smallest_gamma", "the smallest of a pair"),
        Step("modal/pair.py", "PairWeights.gains", "twice that, for its law"),
        Step("modal/pair.py", "pair_gains", "gains over λ"),
        Step("modal/law.py", "_kept_gains", "the same for equal arms"),
        Step("modal/law.py", "ModalLaw.tuned", "the law of an arm"),
        Step("designs/workspace/search.py", "_candidates", "a law that is tried"),
    ),
    "a measurement": (
        Step("loop/simulation/program.py", "Channel.quantised", "in steps of the sensor"),
        Step("loop/simulation/program.py", "measure_function", "with noise"),
        Step("loop/simulation/program.py", "loop_program", "of this sample"),
        Step("loop/controller/controller.py", "Controller.steps", "the step's argument"),
        Step("loop/controller/controller.py", "Controller._stepped", "beside the memory"),
        Step("loop/controller/step.py", "controller_step", "an estimate, an input"),
        Step("loop/controller/measured.py", "corrected", "what the filter takes"),
    ),
    "a sample of a campaign": (
        Step("campaign/draws.py", "Tolerances.samples", "numbers by seed and index"),
        Step("campaign/batches.py", "rows_of", "a robot, its run, a row"),
        Step("campaign/batches.py", "run_batches", "with others, anywhere"),
        Step("campaign/driver.py", "_run_in_turn", "each in its turn"),
        Step("campaign/driver.py", "in_this_process", "with its batch", "Rows"),
        Step("campaign/journal.py", "Journal.write", "a row on disk"),
        Step("campaign/driver.py", "_written", "while others run"),
        Step("campaign/driver.py", "drive", "all of them"),
        Step("campaign/results.py", "merged", "one table", "MergedTable"),
        Step("campaign/results.py", "CampaignJudgement", "counted"),
        Step("pages/campaign.py", "write_campaign", "a rate, with its interval"),
    ),
    "a row of a log": (
        Step("identification/log_files.py", "file_columns", "text"),
        Step("identification/log_reader.py", "read_log", "SI units, by signal"),
        Step("identification/filtering.py", "log_arrays", "times, inputs, outputs"),
        Step("identification/identify.py", "identify", "rows of one period"),
        Step("identification/likelihood.py", "Likelihood", "an innovation"),
        Step("identification/search.py", "searched", "the likeliest numbers", "Evaluation"),
        Step("identification/identify.py", "judgement", "fits, or not", "Consistency"),
        Step("identification/identify.py", "Identification", "numbers with intervals"),
        Step("pages/identify.py", "IdentifiedRobot", "a table of the page"),
    ),
}


def broken() -> list[str]:
    """Steps that the code does not take, in words."""
    found = []
    for number, steps in FOLLOWED.items():
        for here, there in pairwise(steps):
            one, other = _code(here), _code(there)
            if here.via:
                passed = here.via in one and here.via in other
            else:
                passed = _last(there) in one or _last(here) in other
            if not (one and other and passed):
                found.append(f"{number}: {here.file} {here.name} -> {there.file} {there.name}")
    return found


def _last(step: Step) -> str:
    return step.name.rpartition(".")[2]


def _code(step: Step) -> str:
    """The source of a step's function, class or field; empty where there is none."""
    text = (PACKAGE / step.file).read_text(encoding="utf-8")
    nodes: list[ast.stmt] = ast.parse(text).body
    node: ast.stmt | None = None
    for name in step.name.split("."):
        node = next((one for one in nodes if _name(one) == name), None)
        nodes = getattr(node, "body", [])
    return "" if node is None else ast.get_source_segment(text, node) or ""


def _name(node: ast.stmt) -> str:
    if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
        return node.target.id
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
        return node.targets[0].id
    return getattr(node, "name", "")


WIDTH, HEIGHT, LEFT, GAP = 186, 62, 180, 18


def figure() -> str:
    """A lane for each number, with a box for each step."""
    most = max(map(len, FOLLOWED.values()))
    size = f"0 0 {LEFT + most * WIDTH} {len(FOLLOWED) * (HEIGHT + GAP) + 8}"
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{size}" font-family="sans-serif" font-size="11">',
        '<rect width="100%" height="100%" fill="#ffffff"/>',
        '<defs><marker id="to" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0L8 4L0 8Z" fill="#52606d"/></marker></defs>',
    ]
    for lane, (number, steps) in enumerate(FOLLOWED.items()):
        y = 6 + lane * (HEIGHT + GAP)
        parts.append(
            f'<text x="8" y="{y + 36}" font-size="13" font-weight="bold" fill="#1f2933">{number}</text>'
        )
        for place, step in enumerate(steps):
            parts += _box(step, LEFT + place * WIDTH, y, last=place + 1 == len(steps))
    return "\n".join([*parts, "</svg>", ""])


def _box(step: Step, x: int, y: int, last: bool) -> list[str]:
    room, _, rest = step.file.removesuffix(".py").partition("/")
    wide, middle = WIDTH - GAP, y + HEIGHT // 2
    arrow = f'<path d="M{x + wide} {middle}h{GAP - 2}" stroke="#52606d" marker-end="url(#to)"/>'
    return [
        f'<rect x="{x}" y="{y}" width="{wide}" height="{HEIGHT}" rx="5" fill="#f0f4f8" stroke="#9fb3c8"/>',
        f'<text x="{x + 8}" y="{y + 17}" fill="#52606d"><tspan font-weight="bold">{room}</tspan> {escape(rest)}</text>',
        f'<text x="{x + 8}" y="{y + 34}" font-family="monospace" fill="#102a43">{escape(_last(step))}</text>',
        f'<text x="{x + 8}" y="{y + 51}" fill="#1f2933">{escape(step.what)}</text>',
        *([] if last else [arrow]),
    ]
