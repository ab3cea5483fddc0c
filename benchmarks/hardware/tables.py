"""The tables of docs/hardware.md, of the rows that are kept."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

__all__ = ["FINE", "LIMITED", "PAYLOADS", "ROWS", "SENSORS", "TABLES"]

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

#: The model's mass in rows whose robots grip more, kg.
NOMINAL = {"untold": 0.0, "middle": 1.5}

#: The same for a reader.
MEASURED = {"link": "link and motor", "torque": "motor and torque", "motor": "motor alone"}

#: Rows with a payload: that of the model, what a reader is told of it, and the masses (kg) that the true robot carries.
PAYLOADS = {
    "untold": ("0..3kg", "designed for 0 kg", (0.0, 1.0, 2.0, 3.0)),
    "middle": ("0..1.5..3kg", "designed for 1.5 kg", (0.0, 1.0, 2.0, 3.0)),
    "told1": ("1kg", "weighed and designed again", (1.0,)),
    "told2": ("2kg", "weighed and designed again", (2.0,)),
    "told3": ("3kg", "weighed and designed again", (3.0,)),
}


def robots(folder: Path) -> str:
    """Robots and sensors, a line for each: this version, and behind an arrow what the older one did."""
    head = (
        "robot, measured", "damping of the running loop: asked, before → now", "worst overshoot of 200 robots",
        "noise at the motor, share of its limit", "largest input of the step, of its limit",
        "limit cycle at rest", "not met", "CPU time to design",
    )  # fmt: skip
    lines = _head(head)
    for name, measured in _measured():
        now, before = (_row(folder, f"{name}{end}") for end in ("", "-before"))
        linear = _row(folder, f"{name}-linear")
        if now is not None:
            lines.append(_cells(_line(now, before, measured)))
        elif linear is not None:
            found = _damping(linear["damping"]), "", _percent(100.0 * linear["noise_share"]), *[""] * 4
            lines.append(_cells([f"{linear['robot']}: {measured}, linear loop alone", *found]))
    return "\n".join(lines)


def _measured() -> Iterator[tuple[str, str]]:
    """Names of rows, and their sensors for a reader."""
    for robot in ("planar", "spatial", "branching", "panda", "ur5"):
        for end in ("", "-fine") if robot in LIMITED else ("",):
            for sensors, measured in MEASURED.items():
                yield f"{robot}-{sensors}{end}", f"{measured}{', 1e-5 rad' if end else ''}"
    yield "arm-middle", f"{MEASURED['link']}, 1e-5 rad, 0 to 3 kg of payload"


def _line(now: dict[str, Any], before: dict[str, Any] | None, measured: str) -> list[str]:
    name = f"{now['robot']}: {measured}"
    if "refused" in now:
        return [name, f"refused: {now['refused']}", *[""] * 6]

    def both(write: Callable[[dict[str, Any]], str]) -> str:
        if before is None:
            return write(now)
        return f"{'refused' if 'refused' in before else write(before)} → {write(now)}"

    asked = [row["required_damping"] for row in (before, now) if row and row.get("required_damping")]
    required = " → ".join(dict.fromkeys(f"{value:.2g}" for value in asked))
    unsettled = now["unsettled"]
    return [
        name,
        f"{required}: {both(lambda row: _damping(row['damping']))}",
        both(lambda row: _percent(row["overshoot"])) + (f"; {unsettled} do not settle" if unsettled else ""),
        both(lambda row: _percent(100.0 * row["noise_share"])),
        both(lambda row: _percent(100.0 * row["peak_share"])),
        _hunting(now),
        both(lambda row: ", ".join(row["missed"]) or "none"),
        both(lambda row: f"{row['seconds']:.0f} s"),
    ]


def _hunting(row: dict[str, Any]) -> str:
    if "hunts" not in row:
        return "not judged"
    return f"{'yes' if row['hunts'] else 'no'}, {_short(1e3 * max(row['hunting']))} mrad"


def reasons(folder: Path) -> str:
    """Motor-side sensing alone, a sentence for each robot."""
    lines = []
    for robot in ("planar", "spatial", "branching", "panda", "ur5"):
        row = _row(folder, f"{robot}-motor") or _row(folder, f"{robot}-motor-linear")
        if row is None or "best_damping" not in row:
            continue
        noise, most = (_percent(100.0 * row[key]) for key in ("noise_share", "best_noise_share"))
        lines.append(
            f"- **{row['robot']}**: {_damping(row['damping'])} ({row['damping_joint']}, {row['damping_hz']:.0f} Hz), "
            f"with noise of {noise} of what the motor gives. Of {row['tried']} choices of R^v none damps more than "
            f"{_damping(row['best_damping'])}, which takes {most}. In joint {row['hidden_joint']} the link has "
            f"{_percent(100.0 * row['shown_part'])} of the inertia: the motor shows that part of the twist when the "
            f"joint vibrates ({row['vibration_hz']:.0f} Hz), and nothing where the link swings on its spring while the "
            f"motor stands still ({row['zero_hz']:.0f} Hz)."
        )
    return "\n".join(lines)


def payload(folder: Path) -> str:
    """A payload on the arm, a line for each design and mass that is carried."""
    head = (
        "the model", "carried", "step: overshoot, settling", "gripping it: deflection, recovery, what remains",
        "largest input of both, of its limit", "damping, peak sensitivity, gain margin", "weighed",
    )  # fmt: skip
    lines = _head(head)
    for name, (_, told, _) in PAYLOADS.items():
        row = _row(folder, f"arm-{name}")
        for one in [] if row is None else row.get("carried", []):
            gripped = one["mass"] > NOMINAL.get(name, one["mass"])
            lines.append(
                _cells(
                    [
                        told,
                        f"{one['mass']:g} kg",
                        f"{_percent(one['overshoot'])}, {_seconds(one['settling'])}",
                        f"{1e3 * one['sag']:.1f} mrad ({one['sag_joint']}), {_seconds(one['recovery'])}, "
                        f"{_short(1e3 * one['remaining'])} mrad"
                        if gripped
                        else "",
                        _percent(100.0 * (one["gripping_share"] if gripped else one["peak_share"])),
                        f"{_damping(one['damping'])}, {one['peak_sensitivity']:.2f}, {one['gain_margin']:.2f}",
                        f"{max(0.0, one['weighed']):.2f} kg",
                    ]
                )
            )
    return "\n".join(lines)


def arm(folder: Path) -> str:
    """What became of the arm of the first section, in a sentence."""
    row = _row(folder, "arm-middle")
    if row is None or "carried" not in row:
        return "This row has not been measured yet."
    ends, missed = row["carried"], ", ".join(row["missed"])
    worst = min(one["damping"] for one in ends)
    met = f"NOT MET: {missed}" if missed else "all requirements are met"
    noise, gripping = (
        _percent(100.0 * share) for share in (row["noise_share"], max(one["gripping_share"] for one in ends))
    )
    return (
        f"Measured: {met}. The running loop has a damping ratio of {_damping(row['damping'])} with 1.5 kg, and of at "
        f"least {_damping(worst)} between 0 and 3 kg; the worst of {row['samples']} sampled robots overshoots by "
        f"{_percent(row['overshoot'])}; noise takes {noise} of what a motor gives, the step and gripping 3 kg at most "
        f"{gripping}; at rest no joint moves by more than {_short(1e3 * max(row['hunting']))} mrad. "
        f"Gripping 3 kg deflects it by {_short(1e3 * ends[-1]['sag'])} mrad, and it is back within 2 % of the "
        f"step after {_seconds(ends[-1]['recovery'])}."
    )


TABLES: dict[str, Callable[[Path], str]] = {
    "arm": arm,
    "robots": robots,
    "reasons": reasons,
    "payload": payload,
}


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
