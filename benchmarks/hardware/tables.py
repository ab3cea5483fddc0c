"""The tables of docs/hardware.md, of the rows that are kept."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

__all__ = ["FINE", "LIMITED", "MASSES", "PAYLOADS", "ROWS", "SENSORS", "TABLES"]

#: The rows that the docs show.
ROWS = Path(__file__).resolve().parent / "rows"

#: What is measured, by the name of a row.
SENSORS = {
    "link": ("link_position", "motor_position"),
    "torque": ("motor_position", "joint_torque"),
    "motor": ("motor_position",),
}

#: Robots whose limits of torque the noise of the sensors uses up: measured with finer ones too, of this variance, rad².
LIMITED, FINE = ("panda", "ur5"), 1e-10

#: The same for a reader.
MEASURED = {"link": "link and motor", "torque": "motor and torque", "motor": "motor alone"}

#: Controllers of the arm: payload of the model, what a reader is told of it, and whether the design's own poses and
#: moves are judged. The true robot carries these masses, kg.
PAYLOADS = {
    "empty": ("0..3kg", "0 kg", False),
    "half": ("0..0.5..3kg", "0.5 kg", True),
    "middle": ("0..1.5..3kg", "1.5 kg", True),
}
MASSES = (0.0, 1.0, 2.0, 3.0)


def arm(folder: Path) -> str:
    """Requirements of the controller of the first section."""
    row = _row(folder, "arm-half")
    if row is None or not row["requirements"]:
        return "Not measured yet: `python -m benchmarks.hardware arm-half`."
    return "\n".join(
        [*_head(("where", "requirement", "required", "achieved", "")), *map(_cells, row["requirements"])]
    )


def payload(folder: Path) -> str:
    """A payload on the arm, a line for each controller and mass that is carried."""
    lines = _head((
        "designed for", "carried", "least damping below 350 rad/s", "remains, mrad", "wrong way", "off the path, mrad",
        "largest input, of its limit", "gripping it: deflection, within 1 mrad after", "weighed",
    ))  # fmt: skip
    for name, (_, told, _) in PAYLOADS.items():
        row = _row(folder, f"arm-{name}")
        for one in [] if row is None else row["carried"]:
            damping = (
                f"{one['unstable']} of {row['poses']} unstable"
                if one["unstable"]
                else _damping(one["damping"])
            )
            lines.append(_cells([
                told, f"{one['mass']:g} kg", damping, _short(1e3 * one["remaining_error"]),
                _percent(one["wrong_way_percent"]), _short(1e3 * one["path_distance"]), _percent(100.0 * one["used"]),
                _gripped(one),
                f"{max(0.0, one['weighed']):.2f} kg",
            ]))  # fmt: skip
    return "\n".join(lines)


def _gripped(one: dict[str, Any]) -> str:
    if "sag" not in one:
        return ""
    back = "" if one["back"] == 0.0 else f", {_seconds(one['back'])}"
    return f"{_short(1e3 * one['sag'])} mrad ({one['sag_joint']}){back}"


def robots(folder: Path) -> str:
    """Designs of one pose: robots and sensors, a line for each."""
    lines = _head((
        "robot, measured", "damping: required, reached", "worst overshoot of 200 robots",
        "noise at the motor, of its limit", "largest input of the step, of its limit", "limit cycle at rest", "not met",
        "CPU time to design",
    ))  # fmt: skip
    for name, measured in _measured():
        if (row := _row(folder, name)) is not None:
            lines.append(_cells([f"{row['robot']}: {measured}", *_line(row)]))
    return "\n".join(lines)


def _measured() -> Iterator[tuple[str, str]]:
    """Names of rows, and their sensors for a reader."""
    for robot in ("planar", "spatial", "panda", "ur5"):
        for end in ("", "-fine") if robot in LIMITED else ("",):
            for sensors, measured in MEASURED.items():
                yield f"{robot}-{sensors}{end}", f"{measured}{', 1e-5 rad' if end else ''}"


def _line(row: dict[str, Any]) -> list[str]:
    if "refused" in row:
        return [f"refused: {row['refused']}", *[""] * 6]
    unsettled = f"; {row['unsettled']} do not settle" if row["unsettled"] else ""
    cycle = (
        f"{'yes' if row['hunts'] else 'no'}, {_short(1e3 * max(row['hunting']))} mrad"
        if "hunts" in row
        else ""
    )
    return [
        f"{row['required_damping']:.2g}, {_damping(row['damping'])}", _percent(row["overshoot"]) + unsettled,
        _percent(100.0 * row["noise_share"]), _percent(100.0 * row["peak_share"]), cycle,
        ", ".join(row["missed"]) or "none", f"{row['seconds']:.0f} s",
    ]  # fmt: skip


TABLES: dict[str, Callable[[Path], str]] = {"arm": arm, "payload": payload, "robots": robots}


def _row(folder: Path, name: str) -> dict[str, Any] | None:
    place = folder / f"{name}.json"
    return json.loads(place.read_text(encoding="utf-8")) if place.exists() else None


def _head(titles: tuple[str, ...]) -> list[str]:
    return [_cells(list(titles)), "|---" * len(titles) + "|"]


def _cells(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _damping(value: float) -> str:
    return f"{value:.3f}" if value >= 0.01 else f"{value:.4f}"


def _short(value: float) -> str:
    return f"{value:.2g}" if value < 100.0 else f"{value:.0f}"


def _percent(value: float | None) -> str:
    if value is None:
        return "∞"
    return f"{value:.2g} %" if value < 100.0 else f"{value:.0f} %"


def _seconds(value: float | None) -> str:
    return "not within the run" if value is None else f"{value:.2f} s"
