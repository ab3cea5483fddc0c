"""The tables of docs/comparison_workspaces.md, of the rows that are kept."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.compared.rows import FEW, ROBOTS, kept

__all__ = ["TABLES"]

#: Requirements in the table of laws, with the unit that they are shown in and its factor.
SHOWN = {
    "tracking error": ("mrad, mm", 1e3), "remaining error": ("mrad, mm", 1e3), "damping of oscillations": ("", 1.0),
}  # fmt: skip

MISSING = "not measured"

PERIOD = 1e-3  # s, of every loop here


def laws() -> str:
    """A row for each law of each robot, the best first: of each requirement the number that is nearest to its limit."""
    titles = [f"{what} ({unit})" if unit else what for what, (unit, _) in SHOWN.items()]
    lines = _head(("robot", "law", "bandwidth", *titles, "requirements that it misses"))
    for name in ROBOTS:
        numbers = kept(f"{name}.laws")
        if numbers is None or "stopped" in numbers:
            lines.append(_cells([name, MISSING if numbers is None else numbers["stopped"], *[""] * 5]))
            continue
        rows = {law["name"]: law for law in numbers["laws"]}
        for law in (rows[key] for key in numbers["order"]):
            missed = list(dict.fromkeys(line["what"] for line in law["requirements"] if not line["met"]))
            cells = [name, f"`{law['name']}`", f"{law['bandwidth']:.3g} rad/s"]
            cells += [_worst(law["requirements"], what, factor) for what, (_, factor) in SHOWN.items()]
            lines.append(_cells([*cells, "; ".join(missed) or "none"]))
    return "\n".join(lines)


def _worst(lines: list[dict[str, Any]], what: str, factor: float) -> str:
    """What was found of a requirement where it is nearest to its limit."""
    found = [line for line in lines if line["what"] == what]
    if any(line["found"] is None for line in found):
        return "diverges"
    upper = found[0]["at_most"]
    worst = max(found, key=lambda line: (line["found"] if upper else -line["found"]) / line["limit"])
    return f"{factor * worst['found']:.3g}"


def campaigns() -> str:
    """A row for each robot: how many moves succeed, the worst sample, and the worst robot that the search found."""
    lines = _head((
        "robot", "moves", "succeed, with 95 % confidence", "requirement nearest to its limit",
        "worst sample", "worst robot found in that move", "CPU s: laws, campaign, search",
    ))  # fmt: skip
    for name in ROBOTS:
        row, compared = kept(f"{name}.campaign"), kept(f"{name}.laws") or {}
        if row is None or "stopped" in row:
            lines.append(_cells([name, MISSING if row is None else row["stopped"], *[""] * 5]))
            continue
        cells = [name, f"{row['samples']:,}", _success(row), _words(row["metric"])]
        lines.append(_cells([*cells, _sample(row), _found(row["search"]), _cost(row, compared)]))
    return "\n".join(lines)


def _success(row: Mapping[str, Any]) -> str:
    parts = [f"{count} missed the {_words(name)}" for name, count in row["missed"].items()]
    parts += [f"{count} count as {status}" for status, count in row["lost"].items()]
    told = "".join(f"; {part}" for part in parts)
    return f"{row['samples'] - row['failures']:,} of {row['samples']:,}: {row['interval']}{told}"


def _words(metric: str) -> str:
    return metric.removesuffix("_use").replace("_percent", "").replace("_", " ")


def _sample(row: Mapping[str, Any]) -> str:
    move = [
        ", ".join(f"{row['move'][key]:.2f}" for key in row["move"] if key.startswith(which))
        for which in ("start", "goal")
    ]
    return f"{row['use']:.3g} of what is allowed (sample {row['sample']}: {move[0]} → {move[1]})"


def _found(search: str | Mapping[str, Any]) -> str:
    if isinstance(search, str):
        return search
    if search["status"] != "completed":
        return f"not sought: sample {search['sample']} is {search['status']}, and nothing is worse"
    text = search["text"].partition(", at ")[2].rstrip(".")
    if not text:
        return f"no worse one in {search['runs']:,} runs"
    return f"{search['use']:.3g}, at {text}; {search['runs']:,} runs"


def _cost(row: Mapping[str, Any], compared: Mapping[str, Any]) -> str:
    search = row["search"]
    part = search["cpu_s"] if isinstance(search, Mapping) else math.nan
    numbers = (compared.get("cpu_s", math.nan), row["cpu_s"] - (0.0 if math.isnan(part) else part), part)
    return ", ".join("–" if math.isnan(number) else f"{number:,.0f}" for number in numbers)


def scale() -> str:
    """What the long campaign of moves costs, beside a short one and beside a step at one pose."""
    (name,) = (name for name, robot in ROBOTS.items() if robot.killed)
    row = kept(f"{name}.scale")
    lines = _head(("what", "moves over the workspace", "a step at one pose"))
    if row is None:
        return "\n".join([*lines, _cells([MISSING, "", ""])])
    sides = [(row["moves"], row["moves_cpu_s"], row["move_s"])]
    if step := row["step"]:
        sides += [(step["samples"], step["cpu_s"], step["step_s"])]
    memory = [f"{size:,.0f} MB with {int(count):,}" for count, size in row["memory_mb"].items()]
    replayed = ", ".join(row["replayed"])
    for what, texts in {
        "samples, and processor seconds with the report": [f"{n:,} in {cpu:,.3g}" for n, cpu, _ in sides],
        "simulated time of a sample": [f"{seconds:.3g} s" for *_, seconds in sides],
        "samples in a processor second": [f"{n / cpu:.3g}" for n, cpu, _ in sides],
        "control steps in a processor second": [f"{round(n * s / PERIOD / cpu, -3):,.0f}" for n, cpu, s in sides],
        "largest memory": [", ".join(memory) + f", of which table and report alone {row['report_mb']:,.0f} MB", ""],
        "killed by SIGKILL and continued": [f"the first {FEW:,} rows {_same(row['same'])} those of a whole run", ""],
        "replayed alone": [f"samples {replayed} {_same(all(row['replayed'].values()))} their rows", ""],
    }.items():  # fmt: skip
        lines.append(_cells([what, *texts, *[MISSING] * (2 - len(texts))]))
    return "\n".join(lines)


def _same(same: bool) -> str:
    return "have the bits of" if same else "differ from"


def _head(titles: Sequence[str]) -> list[str]:
    return [_cells(titles), "|---" * len(titles) + "|"]


def _cells(texts: Sequence[str]) -> str:
    return "| " + " | ".join(texts) + " |"


#: By the name that `--table` takes.
TABLES = {"laws": laws, "campaigns": campaigns, "scale": scale}
