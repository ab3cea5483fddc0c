"""The tables of docs/workspace.md, of the rows that are kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks.workspace.arm import PERIOD
from benchmarks.workspace.laws import LAWS
from benchmarks.workspace.linear import DELAYS, GAINS
from benchmarks.workspace.metrics import PUSHED
from benchmarks.workspace.robots import ROBOTS
from benchmarks.workspace.rows import kept, law_name, row_name
from benchmarks.workspace.trip import CONDITIONS

__all__ = ["TABLES"]

MUJOCO, OTHER = "mujoco", "runge-kutta"
PD, MISSING = "pd", "not measured"


def moves(folder: Path) -> str:
    """Moves in MuJoCo's robot: how many arrive, and what remains."""
    lines = _head(
        "robot", "law", "arrive: nominal", "payload", "sampled robots", "second sample of latency",
        "remains: median, worst", "wrong way", "off the path", "ripple", "saturated",
    )  # fmt: skip
    for robot, law in _laws(folder, MUJOCO):
        row, others = _row(folder, robot, law, "nominal"), ("payload", "sampled", "late")
        arrive = [_arrive(row), *(_arrive(_row(folder, robot, law, name)) for name in others)]
        left = row["left_out"] if row else 0
        name = f"{robot} ({left} goals left out)" if left else robot
        lines.append(_cells(name, LAWS[law].title, *arrive, *_numbers(row)))
    return "\n".join(lines)


def _numbers(row: dict[str, Any] | None) -> list[str]:
    if row is None:
        return [MISSING] * 5
    return [
        f"{_milli(row['remaining_median'])}, {_milli(row['remaining_worst'])}",
        _percent(row["wrong_way"]),
        _milli(row["path"]),
        _percent(row["ripple"]),
        _percent(row["saturation"]),
    ]


def loops(folder: Path) -> str:
    """Linear loops at random poses with one sample of latency, CPU time, and the size of the exported C.

    The time of a step is also in parts of that of PD, which ran on the same machine.
    """
    lines = _head(
        "robot", "law", "share s (at most)", "stable", "worst damping below 350 rad/s", "of faster ones",
        "extra delay, samples (springs damped by 0.5 %)", "gain margin", "CPU: design", "a step (of PD's)", "C, bytes",
    )  # fmt: skip
    for robot in ROBOTS:
        for law, choice in LAWS.items():
            record = kept(folder, law_name(robot, law, True))
            if record is None:
                continue
            if "refused" in record:
                lines.append(_cells(robot, choice.title, f"refused: {record['refused']}", *[""] * 8))
                continue
            row, unit = (_row(folder, robot, name, "nominal") for name in (law, PD))
            size = record.get("object_bytes")
            delay = f"{_margin(record['delay'], DELAYS)} ({_margin(record['damped_delay'], DELAYS)})"
            lines.append(
                _cells(
                    robot,
                    choice.title,
                    f"{record['share']:g} ({record['fastest']:g} rad/s)" if "share" in record else "",
                    f"{record['stable']} of {record['poses']}",
                    _number(record["damping"]),
                    _number(record["fast"]),
                    delay,
                    _margin(record["gain"], GAINS),
                    f"{record['design_cpu']:.0f} s",
                    MISSING if row is None else _time(row["step_cpu"], unit),
                    "–" if size is None else f"{size:,}",
                )
            )
    return "\n".join(lines)


def others(folder: Path) -> str:
    """Without friction, a push, bare steps, motor encoders alone."""
    lines = _head(
        "robot", "law", "motor encoders alone: arrive, worst that remains",
        "without dry friction: arrive, worst that remains", "pushes: peak, back within 2 %, worst 0.4 s later",
        "bare steps: wrong way, others move",
    )  # fmt: skip
    for robot, law in _laws(folder, MUJOCO):
        free, push, steps, motors = (
            _row(folder, robot, law, name) for name in ("frictionless", "push", "steps", "motors")
        )
        lines.append(
            _cells(
                robot,
                LAWS[law].title,
                "needs those of the links" if LAWS[law].needs_links else _both(motors),
                _both(free),
                MISSING
                if push is None
                else f"{push['moves']}: {_milli(push['peak'])}, {_back(push)}, "
                f"{_milli(push['remaining_worst'])}",
                MISSING
                if steps is None
                else f"{steps['moves']}: {_percent(steps['wrong_way'])}, {_percent(steps['excursion'])}",
            )
        )
    return "\n".join(lines)


def plants(folder: Path) -> str:
    """The same moves in both simulators."""
    lines = _head(
        "robot",
        "law",
        "condition",
        "arrive: MuJoCo",
        "Runge–Kutta",
        "worst that remains: MuJoCo",
        "Runge–Kutta",
    )
    for robot, law in _laws(folder, OTHER):
        for condition in CONDITIONS:
            one, other = (_row(folder, robot, law, condition, plant) for plant in (MUJOCO, OTHER))
            if one is not None and other is not None:
                worst = (_milli(row["remaining_worst"]) for row in (one, other))
                lines.append(_cells(robot, LAWS[law].title, condition, _arrive(one), _arrive(other), *worst))
    return "\n".join(lines)


TABLES: dict[str, Callable[[Path], str]] = {
    "moves": moves,
    "loops": loops,
    "others": others,
    "plants": plants,
}


def _laws(folder: Path, plant: str) -> Iterator[tuple[str, str]]:
    """Robots and laws of which there is a row in this plant, rivals first."""
    for robot in ROBOTS:
        for law in LAWS:
            if any(kept(folder, row_name(robot, law, plant, name)) for name in CONDITIONS):
                yield robot, law


def _row(folder: Path, robot: str, law: str, condition: str, plant: str = MUJOCO) -> dict[str, Any] | None:
    return kept(folder, row_name(robot, law, plant, condition))


def _head(*titles: str) -> list[str]:
    return [_cells(*titles), "|---" * len(titles) + "|"]


def _cells(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def _arrive(row: dict[str, Any] | None) -> str:
    if row is None:
        return MISSING
    return f"{row['arrived']} of {row['moves']}" + (f"; {row['lost']} lost" if row["lost"] else "")


def _both(row: dict[str, Any] | None) -> str:
    return MISSING if row is None else f"{_arrive(row)}, {_milli(row['remaining_worst'])}"


def _back(row: dict[str, Any]) -> str:
    """When all joints are back after a push, at the latest."""
    late = "lost" if row["lost"] else f"not in {1e3 * PERIOD * PUSHED:.0f} ms"
    return late if row["back"] is None else f"{1e3 * row['back']:.0f} ms"


def _time(step: float, unit: dict[str, Any] | None) -> str:
    """Of a step, and in parts of the one of another row."""
    text = f"{1e6 * step:.0f} µs"
    return text if unit is None else f"{text} ({_digits(step / unit['step_cpu'])})"


def _number(value: float | None) -> str:
    return "no loop" if value is None else f"{value:.2g}" if abs(value) < 0.1 else f"{value:.2f}"


def _margin(value: float | None, tried: Sequence[float]) -> str:
    return "unstable" if value is None else f"≥ {value:g}" if value >= tried[-1] else f"{value:.2f}"


def _milli(value: float | None) -> str:
    """In mrad, or mm where a joint slides."""
    return "lost" if value is None else f"{_digits(1e3 * value)} mrad"


def _percent(value: float | None) -> str:
    return "lost" if value is None else f"{_digits(value)} %"


def _digits(value: float) -> str:
    """Two digits, none after the point from ten on; nothing below a thousandth."""
    return "0" if value < 1e-3 else f"{value:.2g}" if value < 9.95 else f"{value:.0f}"
