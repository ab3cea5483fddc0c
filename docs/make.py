"""Tables, transcripts and figures of the pages, computed by the code and written between markers.

    python docs/make.py              every part (some of them take minutes)
    python docs/make.py options      only this one
    python docs/make.py --check …    changes nothing; exit code 1 where a page is not what the code computes

A part stands between ``<!-- made: NAME -->`` and ``<!-- end -->``. `make test` checks some of the quick parts, `make
ci` the others, and `make nightly` those that make several designs.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import itertools
import json
import os
import runpy
import shlex
import subprocess
import sys
import tempfile
import textwrap
import tomllib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "flexhinf"
IMAGES = ROOT / "docs" / "images"

#: Drawings that the parts made, by file; `main` writes them.
DRAWN: dict[Path, str | bytes] = {}


# Options --------------------------------------------------------------------------------------------
def commands(group: Any = None, path: str = "flexhinf") -> dict[str, dict[str, Any]]:
    """The declared options of every command, by its words."""
    from typer.main import get_command

    from flexhinf.cli.commands import app

    found = {}
    for name, command in (group or get_command(app)).commands.items():  # type: ignore[attr-defined]
        if hasattr(command, "commands"):
            found |= commands(command, f"{path} {name}")
        elif declared := getattr(inspect.unwrap(command.callback), "options", {}):
            found[f"{path} {name}".removesuffix(" run") if "campaign" in path else f"{path} {name}"] = (
                declared
            )
    return found


def options() -> str:
    """Every option: those of a specification with the commands that take them, then the others by command, each
    explained once."""
    from flexhinf.designs.specification import FIELDS
    from flexhinf.options import GROUPS

    every, lines, seen = commands(), [], set()
    for group in GROUPS:
        rows = [_row(field, every) for field in FIELDS.values() if field.about.group == group]
        lines += (
            _table(group, "| option | meaning | allowed | default | read by | not of |", rows) if rows else []
        )
    for command, declared in every.items():
        rows = [
            _row(field)
            for name, field in declared.items()
            if field is not FIELDS.get(name) and field.about.group
        ]
        known = [row[0] for row in rows if row in seen]
        title = f"`{command}`" + (f", and as above {', '.join(known)}" if known else "")
        new = [row for row in rows if row not in seen]
        lines += _table(title, "| option | meaning | allowed | default |", new)
        seen |= set(rows)
    return "\n".join(lines).strip()


def _table(title: str, head: str, rows: Iterable[Sequence[str]]) -> list[str]:
    cells = ["| " + " | ".join(cell.replace("|", r"\|") for cell in row) + " |" for row in rows]
    table = ["", head, "|---" * (head.count("|") - 1) + "|", *cells] if cells else []
    return ["", f"**{title}**", *table]


def _row(field: Any, every: dict[str, dict[str, Any]] | None = None) -> tuple[str, ...]:
    """Option, help, range and default of a field; of a specification the designs that read it, and the commands that do
    not."""
    from flexhinf.designs.fields import readers

    about, default = field.about, field.default
    said = about.default or (
        "" if default is False or default in (None, (), "", dataclasses.MISSING) else f"`{_text(default)}`"
    )
    unit = f" ({about.unit})" if about.unit and about.unit not in field.allowed else ""
    allowed = "" if field.allowed == "text" else field.allowed
    row = (f"`{field.option.partition('/')[0]}`", about.help, f"{allowed}{unit}".strip(), said)
    if every is None:
        return row
    tasks = {"pose": "a pose", "workspace": "a workspace"}
    kinds = readers().get(field.name)
    read = [tasks[field.name]] if field.name in tasks else ["every design"]
    if kinds is not None:
        read = [f"`{kind.name}`" for kind in kinds] or ["a pose"]
    without = [name for name in ("compare", "certify") if field.name not in every[f"flexhinf {name}"]]
    return (*row, " or ".join(read), ", ".join(without))


def _text(value: object) -> str:
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


# Architecture ---------------------------------------------------------------------------------------
def floors() -> list[list[str]]:
    """The rooms of the import contract, from the top floor down."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    layers = project["tool"]["importlinter"]["contracts"][0]["layers"]
    rows = [[name.strip() for name in layer.split("|")] for layer in layers]
    kept = [[name for name in row if (PACKAGE / name).exists() or _file(name).exists()] for row in rows]
    return [row for row in kept if row]


def _file(name: str) -> Path:
    return PACKAGE / f"{name}.py"


def imports(room: str) -> set[str]:
    """The other rooms that the files of a room import, type annotations included."""
    files = [_file(room)] if _file(room).exists() else (PACKAGE / room).rglob("*.py")
    found = set()
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("flexhinf"):
                parts = (node.module or "").split(".")
                found |= {parts[1]} if len(parts) > 1 else {alias.name for alias in node.names}
            elif isinstance(node, ast.Import):
                found |= {
                    alias.name.split(".")[1] for alias in node.names if alias.name.startswith("flexhinf.")
                }
    return found - {room}


def rooms() -> str:
    """The figure of the floors, and the files of every room."""
    DRAWN[IMAGES / "architecture.svg"] = figure()
    lines = [
        "![The rooms, from the command line down; a line is an import](images/architecture.svg)",
        "",
        "```text",
    ]
    for row in floors():
        for room in row:
            if (PACKAGE / room).is_dir():
                lines += [f"{room}/", *_tree(PACKAGE / room, 1)]
            else:
                lines.append(f"{room}.py")
    return "\n".join([*lines, "```"])


def _tree(folder: Path, depth: int) -> list[str]:
    files = sorted(path.stem for path in folder.glob("*.py") if path.stem != "__init__")
    lines = _wrapped(files, "  " * depth)
    for inner in sorted(path for path in folder.iterdir() if (path / "__init__.py").exists()):
        lines += [f"{'  ' * depth}{inner.name}/", *_tree(inner, depth + 1)]
    return lines


def _wrapped(names: list[str], indent: str) -> list[str]:
    lines, line = [], indent
    for name in names:
        if len(line) + len(name) > 110:
            lines.append(line.rstrip())
            line = indent
        line += name + "  "
    return [*lines, line.rstrip()] if line.strip() else lines


def counts() -> str:
    """What each room has, which says how large the package is."""
    made: str = runpy.run_path(str(ROOT / "docs" / "counts.py"))["table"]()
    return made


#: Of the figure, px.
WIDTH, HEIGHT, BOX, GAP = 860, 62, 96, 18

#: Where a floor stands beside the middle, px, so that no line runs behind a box; of further floors 0.
ASIDE = (20, 20, -140, 20, -240, 80, 250, -160, 0, -20, 340, -20, 0, -300, -200, 60)

#: Rooms that all others may import; their lines would say nothing.
EVERYWHERE = {"arrays", "errors", "notebook", "processors"}


def figure() -> str:
    """SVG: one row per floor, one box per room, a line for every import that no other import implies."""
    rows = [row for row in floors() if row not in (["__main__"],)]
    places = {}
    for y, (row, aside) in enumerate(itertools.zip_longest(rows, ASIDE[: len(rows)], fillvalue=0)):
        left = (WIDTH - len(row) * BOX - (len(row) - 1) * GAP) / 2 + aside
        places |= {room: (left + x * (BOX + GAP), 14 + y * HEIGHT) for x, room in enumerate(row)}
    graph = {  # downwards: the contract names the few imports upwards, which happen when they are called
        room: {
            other
            for other in imports(room) & places.keys() - EVERYWHERE
            if places[other][1] > places[room][1]
        }
        for room in places
    }
    drawn = [
        (room, other) for room in graph for other in sorted(graph[room]) if not _implied(graph, room, other)
    ]
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {len(rows) * HEIGHT + 4}" '
        'font-family="sans-serif" font-size="13" text-anchor="middle">',
        "<title>Rooms of flexhinf and their imports</title>",
    ]
    for room, other in drawn:
        (x1, y1), (x2, y2) = places[room], places[other]
        parts.append(
            f'<line x1="{x1 + BOX / 2:g}" y1="{y1 + 34:g}" x2="{x2 + BOX / 2:g}" y2="{y2:g}" stroke="#8a94a6"/>'
        )
    for room, (x, y) in places.items():
        parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{BOX}" height="34" rx="5" fill="#eef3fb" stroke="#44546a"/>'
        )
        parts.append(f'<text x="{x + BOX / 2:g}" y="{y + 22:g}" fill="#1d2733">{room}</text>')
    return "\n".join([*parts, "</svg>", ""])


def _implied(graph: dict[str, set[str]], room: str, other: str) -> bool:
    """Whether another import of the room leads to the same one."""
    waiting, seen = list(graph[room] - {other}), set()
    while waiting:
        current = waiting.pop()
        if current == other:
            return True
        if current not in seen:
            seen.add(current)
            waiting += graph[current]
    return False


# Designs --------------------------------------------------------------------------------------------
def readme_figure(name: str) -> Callable[[], str]:
    """A figure of a page and its text."""

    def made() -> str:
        DRAWN[IMAGES / f"{name}.svg"], text = runpy.run_path(str(ROOT / "docs" / "readme_step.py"))[name]()
        return text

    return made


def followed() -> str:
    """The figure of numbers that are followed through the rooms."""
    DRAWN[IMAGES / "followed.svg"] = runpy.run_path(str(ROOT / "docs" / "followed.py"))["figure"]()
    return "![Six numbers, from where they come in to where they are read](images/followed.svg)"


def study(name: str) -> Callable[[], str]:
    """The table of a program of this folder, which has a function of its own name."""
    return lambda: runpy.run_path(str(ROOT / "docs" / f"{name}.py"))[name]()


def refusal() -> str:
    """What the command line prints of a peak input that cannot be kept."""
    command = "flexhinf design paper --pose 90deg --start 0 --bandwidth 4 --damping 0.3 --peak-effort 15"
    return f"```text\n$ {command}\n{_printed(command)}\n```"


def _printed(command: str) -> str:
    """Standard error of a command that is refused."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "COLUMNS": "160"}
    with tempfile.TemporaryDirectory() as folder:
        outcome = subprocess.run(
            [sys.executable, "-m", *shlex.split(command)],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
    assert outcome.returncode == 2, outcome.stderr
    lines = outcome.stderr[outcome.stderr.index("error:") :].strip().splitlines()
    return "\n".join(textwrap.fill(line, 130, subsequent_indent=" " * 9) for line in lines)


def presets() -> str:
    """The designs of the paper's arm by each preset, at 90° and 180°."""
    import flexhinf as fh
    from flexhinf.analysis import ToleranceBox
    from flexhinf.designs import Specification, design

    head = (
        "goal, preset", "smallest damping: law, running loop", "peak sensitivity, gain margin, delay margin",
        "stable up to: times the tolerances", "noise at the motor",
        "unstable corners: as designed, other R^v", "step: overshoot, settling, peak input",
        "sampled robots: worst overshoot, not settled", "link under load", "requirements not met",
        "γ proved for all tolerances",
    )  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    robot = fh.paper_arm()
    for goal, preset in itertools.product((90, 180), ("paper", "damped", "robust", "proved")):
        fields: dict[str, Any] = {
            "pose": f"{goal}deg", "start": 0.0, "preset": preset, "extras": ("inductance",), "peak_effort": 60.0,
            "rays": 0,
        }  # fmt: skip
        found = design(robot, Specification(**fields)).evidence
        e = found.evaluation
        m, corners, samples, step, deflection = (
            e.margins,
            e.corners,
            e.step_samples,
            e.step,
            e.load_response.deflection.value,
        )
        assert corners is not None
        assert samples is not None
        loop = e.loop
        edge = ToleranceBox.of(loop, robot.corner, robot.uncertain).edge(loop)[0]
        other = max(int(swept.unstable) for swept in corners.swept)
        load = float(np.max(np.abs(e.load_response.load)))
        missed = [line.what for line in found.requirements if not line.met]
        cells = (
            f"{goal}°, {preset}",
            f"{min(mode.damping for mode in found.law_modes if mode.damping < 1.0):.2f}, {m.damping:.3f}",
            f"{m.peak_sensitivity:.2f}, {m.gain_margin:.2f}, {1e3 * m.delay_margin_s:.0f} ms",
            f"{edge:.2f}",
            f"{1e3 * e.input_noise:.0f} mV",
            f"{corners.unstable}, at most {other} of {corners.count}",
            f"{step.overshoot.value:.1f} %, {step.settling.value:.2f} s, {step.peak.value:.1f} V",
            f"{_finite(samples.overshoot.max(), '%')}, {samples.unsettled} of {len(samples)}",
            f"{1e3 * deflection / load:.0f} mrad per N·m",
            ", ".join(dict.fromkeys(missed)) or "none",
            "–" if found.synthesis.proved is None else f"{found.synthesis.proved.gamma:.0f}",
        )
        lines.append("| " + " | ".join(cells) + " |")
        print(lines[-1], flush=True)
    return "\n".join(lines)


def _finite(value: float, unit: str, digits: int = 1) -> str:
    return f"{value:.{digits}f} {unit}" if np.isfinite(value) else "none"


# Pictures -------------------------------------------------------------------------------------------
def pictures() -> dict[str, tuple[str, Callable[[], str]]]:
    """The pictures of the guides, each made by the block after it."""
    found = runpy.run_path(str(ROOT / "docs" / "pictures.py"))

    def picture(page: str) -> Callable[[], str]:
        def made() -> str:
            place, content, line = found["made"](page)
            DRAWN[place] = content
            return line

        return made

    return {
        f"picture-{page.rpartition('/')[2]}": (f"docs/{page}.md", picture(page)) for page in found["PICTURES"]
    }


# Promises -------------------------------------------------------------------------------------------
def promises() -> str:
    """How many attempts of the fuzzers ended with neither a right answer nor an error of ours.

    How the others divide depends on the processor: a filter that rounds otherwise answers where another one refuses.
    """
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    command = [sys.executable, "-m", "fuzz"]
    outcome = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr
    return without_division(outcome.stdout)


def without_division(table: str) -> str:
    """The table of the fuzzers without the columns "right" and "refused"."""
    rows = [line.strip("|").split("|") for line in table.strip().splitlines()]
    return "\n".join(
        "|" + "|".join((what, attempts, neither)) + "|" for what, attempts, _, _, neither in rows
    )


# Benchmarks -------------------------------------------------------------------------------------------
def benchmark(*words: str) -> Callable[[], str]:
    """A table of the rows that a module of benchmarks has measured and kept."""

    def made() -> str:
        command = [sys.executable, "-m", *words]
        environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
        outcome = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
        )
        assert outcome.returncode == 0, outcome.stderr
        return outcome.stdout.strip()

    return made


def nightly() -> str:
    """The last run of ``make nightly``, as it is kept in build/cpu.json."""
    kept = json.loads((ROOT / "build" / "cpu.json").read_text(encoding="utf-8"))["nightly"]
    outcomes = ", ".join(f"{count} {kind}" for kind, count in kept["outcomes"].items())
    return f"The last one, of {kept['date']}: {outcomes}; {kept['total']:,.0f} CPU seconds."


def arm() -> str:
    """The file of the arm, as it is shown."""
    text = (ROOT / "benchmarks" / "hardware" / "arm.toml").read_text(encoding="utf-8")
    return f"```toml\n# file: arm.toml\n{text}```"


def trajectories() -> str:
    """The table of trajectories, whose rows tests run."""
    return runpy.run_path(str(ROOT / "tests" / "export" / "trajectory_cases.py"))["table"]()


def stops() -> str:
    """Reasons of a protective stop."""
    from flexhinf.stops import STOPS, Stop

    rows = [("bit, reason", "what it says", "when", "look at"), ("---",) * 4]
    rows += [(f"{Stop[name.upper()]:d}, `{name}`", *reason) for name, reason in STOPS.items()]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


# Pages ----------------------------------------------------------------------------------------------
#: Page and generator of every part; the slow ones are those that design.
QUICK: dict[str, tuple[str, Callable[[], str]]] = {
    "options": ("docs/options.md", options),
    "rooms": ("docs/architecture.md", rooms),
    "followed": ("docs/architecture.md", followed),
    "counts": ("docs/architecture.md", counts),
    "frozen": ("docs/architecture.md", benchmark("benchmarks.frozen", "--table")),
    "arm": ("docs/hardware.md", arm),
    "trajectories": ("docs/ros2.md", trajectories),
    "stops": ("docs/supervision.md", stops),
    "arm-result": ("docs/hardware.md", benchmark("benchmarks.hardware", "--table", "arm")),
    "robots": ("docs/hardware.md", benchmark("benchmarks.hardware", "--table", "robots")),
    "payload": ("docs/hardware.md", benchmark("benchmarks.hardware", "--table", "payload")),
    "workspace-criterion": (
        "docs/workspace.md",
        benchmark("benchmarks.workspace", "--table", "criterion"),
    ),
    "workspace-better": ("docs/workspace.md", benchmark("benchmarks.workspace", "--table", "better")),
    "workspace-many": ("docs/workspace.md", benchmark("benchmarks.workspace", "--table", "many")),
    **{
        f"limits-{table}": ("docs/limits.md", benchmark("benchmarks.limits", "--table", table))
        for table in (
            "short",
            "met",
            "rest",
            "limits",
            "before",
            "tracking",
            "rivals",
            "pushes",
            "stops",
            "encoders",
            "frames",
        )
    },
    **{
        name: ("docs/comparison_workspaces.md", benchmark("benchmarks.compared", "--table", table))
        for name, table in (
            ("compared", "laws"),
            ("compared-campaigns", "campaigns"),
            ("compared-scale", "scale"),
        )
    },
    "which-laws": ("docs/which_law.md", benchmark("benchmarks.workspace", "--table", "laws")),
    "which-sensors": ("docs/which_law.md", benchmark("benchmarks.workspace", "--table", "sensors")),
    "which-gamma": ("docs/which_law.md", benchmark("benchmarks.workspace", "--table", "gamma")),
    "masses": ("docs/certificate_study.md", benchmark("benchmarks.workspace", "--table", "masses")),
    "certificates": ("docs/certificate_study.md", benchmark("benchmarks.certificates", "--table")),
    "firmware": ("docs/firmware_study.md", benchmark("benchmarks.firmware", "--table")),
    "codegen": ("docs/architecture.md", benchmark("benchmarks.codegen", "--table")),
    "firmware-peers": ("docs/firmware_study.md", benchmark("benchmarks.firmware", "--table", "peers")),
    "firmware-tests": ("docs/firmware_study.md", benchmark("benchmarks.firmware", "--table", "tests")),
    "firmware-worst": ("docs/firmware_study.md", benchmark("benchmarks.firmware", "--table", "worst")),
    "firmware-trajectories": (
        "docs/firmware_study.md",
        benchmark("benchmarks.firmware", "--table", "trajectories"),
    ),
    **{
        f"faults-{table}": ("docs/firmware_study.md", benchmark("benchmarks.faults", "--table", table))
        for table in ("arms", "groups", "hidden", "harmless", "faults")
    },
    "estimators-speed": ("docs/estimators_speed.md", benchmark("benchmarks.estimator", "--table")),
    "hard-filters": ("docs/estimators_accuracy.md", benchmark("benchmarks.filters", "--table", "hard")),
    "public-robots": ("docs/hardware.md", benchmark("benchmarks.robots", "--table")),
    "interfaces": ("docs/real_loop.md", benchmark("benchmarks.interfaces", "--table")),
    "interface-choice": ("docs/drives.md", benchmark("benchmarks.interfaces", "--table", "choice")),
    "drives": ("docs/real_loop.md", benchmark("benchmarks.drives", "--table")),
    "feedforward": ("docs/real_loop.md", benchmark("benchmarks.feedforward", "--table")),
    "gears": ("docs/real_loop.md", benchmark("benchmarks.gears", "--table")),
    "nees": ("docs/estimators_accuracy.md", benchmark("benchmarks.filters", "--table", "nees")),
}
SLOW: dict[str, tuple[str, Callable[[], str]]] = {
    "swing": ("README.md", readme_figure("swing")),
    "moves": ("docs/design.md", readme_figure("moves")),
    "step": ("docs/design.md", readme_figure("step")),
    "refusal": ("docs/design.md", refusal),
    "presets": ("docs/weights.md", presets),
    "circle": ("docs/identify.md", study("circle")),
    "augmentation": ("docs/augmentation.md", study("augmentation")),
    "promises": ("docs/promises.md", promises),
    **pictures(),
}


#: Records of a run, which nothing can compute again: `make nightly` writes its own.
RECORDS: dict[str, tuple[str, Callable[[], str]]] = {"nightly": ("docs/promises.md", nightly)}


def written(name: str) -> str:
    """The text of the page with one part made anew."""
    page, make = {**QUICK, **SLOW, **RECORDS}[name]
    made = make()  # may take minutes, in which the page is edited
    text = (ROOT / page).read_text(encoding="utf-8")
    before, start, rest = text.partition(f"<!-- made: {name} -->\n")
    _, end, after = rest.partition("<!-- end -->")
    if not (start and end):
        raise SystemExit(f"{page}: no markers for {name!r}")
    return f"{before}{start}\n{made}\n\n{end}{after}"


def main(arguments: list[str]) -> int:
    """Write the parts that are named, or all; returns the exit code."""
    check = "--check" in arguments
    names = [name for name in arguments if name != "--check"] or [*QUICK, *SLOW]
    stale = []
    for name in names:
        page = ROOT / {**QUICK, **SLOW, **RECORDS}[name][0]
        new, old = written(name), page.read_text(encoding="utf-8")
        if old != new:
            stale.append(name)
            if not check:
                page.write_text(new, encoding="utf-8")
        for path, text in DRAWN.items() if not check else ():
            path.write_bytes(text if isinstance(text, bytes) else text.encode())
        print(f"{name}: {'differs from' if check and old != new else 'is'} {page.relative_to(ROOT)}")
    return int(check and bool(stale))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
