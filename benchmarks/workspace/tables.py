"""The tables of docs/workspace.md, of the rows that are kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.workspace import gamma, masses
from benchmarks.workspace.arm import PERIOD
from benchmarks.workspace.laws import LAWS
from benchmarks.workspace.linear import DELAYS, GAINS
from benchmarks.workspace.metrics import MOST, PUSHED, STEPS
from benchmarks.workspace.robots import ROBOTS
from benchmarks.workspace.rows import kept, law_name, lines_of, row_name
from benchmarks.workspace.trip import CONDITIONS

__all__ = ["MANY", "SHORT", "TABLES", "best_rival", "criterion"]

MUJOCO, OTHER = "mujoco", "runge-kutta"
#: Folder, among the rows, of those with more goals.
MANY = "200-goals"
PD, MISSING = "pd", "not measured"
#: Laws of the product; the one that the criterion is for.
PRODUCT, OVER_ALL = ("one-pose", "workspace"), "workspace"
#: The robot of one joint: no other joint moves when it does.
SINGLE = "paper"


# The criterion ------------------------------------------------------------------------------------
def criterion(folder: Path, robot: str, law: str) -> dict[str, tuple[bool, str]] | None:
    """Lines of the criterion: whether each is kept, and what was found; None where rows of them are missing.

    Arms of several joints have two lines more, of bare steps; they are left out where these were not measured.
    """
    record = kept(folder, law_name(robot, law, True))
    rows = [_row(folder, robot, law, name) for name in ("nominal", "payload", "sampled")]
    if record is None or "refused" in record or None in rows:
        return None
    lines = {
        f"arrive, {name}": (row["arrived"] == row["moves"], _arrive(row))
        for name, row in zip(("nominal", "payload", "sampled"), rows)
        if row is not None
    }
    stable, met = record["stable"] == record["poses"], lines_of(record)
    for key, title in (("damping", "damping"), ("delay", "extra delay"),
                       ("damped_delay", "extra delay with damped springs"), ("gain", "gain margin")):  # fmt: skip
        said = _number(record[key]) if key == "damping" else _margin(record[key], (np.inf,))
        lines[title] = (
            met[key],
            said if stable else f"stable at {record['stable']} of {record['poses']} poses",
        )
    bounds = [("moves", rows[0], MOST)]
    if robot != SINGLE and (steps := _row(folder, robot, law, "steps")) is not None:
        bounds.append(("bare steps", steps, STEPS))
    for what, row, most in bounds:
        for key, title in (("wrong_way", "wrong way"), ("excursion", "others move"), ("ripple", "ripple")):
            if key in most:
                kept_line = row[key] is not None and row[key] <= most[key]
                lines[f"{title} in {what}" if key != "ripple" else title] = kept_line, _percent(row[key])
    return lines


def best_rival(folder: Path, robot: str) -> str | None:
    """The rival that keeps most lines of the criterion; of these that which arrives most often, and remains nearest."""

    def order(law: str) -> tuple[float, ...]:
        rows = [_row(folder, robot, law, name) for name in ("nominal", "payload", "sampled")]
        worst = rows[0]["remaining_worst"]
        met = sum(met for met, _ in criterion(folder, robot, law).values())
        return met, sum(row["arrived"] for row in rows), -np.inf if worst is None else -worst

    rivals = [law for law in LAWS if law not in PRODUCT and criterion(folder, robot, law) is not None]
    return max(rivals, key=order, default=None)


def judgement(folder: Path) -> str:
    """The law for the workspace and the best of its rivals against the criterion, on each robot."""
    lines = _head("robot", "law", "lines kept", "not kept")
    for robot in ROBOTS:
        for law in (best_rival(folder, robot), OVER_ALL):
            found = None if law is None else criterion(folder, robot, law)
            if found is None:
                lines.append(_cells(_dated(folder, robot), LAWS[OVER_ALL].title, MISSING, ""))
                continue
            missed: dict[str, list[str]] = {}
            for name, (met, said) in found.items():
                if not met:
                    missed.setdefault(said, []).append(name)
            count = f"{sum(met for met, _ in found.values())} of {len(found)}"
            texts = [f"{', '.join(names)} ({said})" for said, names in missed.items()]
            lines.append(_cells(_dated(folder, robot), LAWS[law].title, count, "; ".join(texts) or "–"))
    return "\n".join(lines)


#: Rivals in few words, and what they may be better at: condition (none: linear loops), key, title, whether more is
#: better, and how it is written.
SHORT = {
    "pd": "PD",
    "pd-integral": "PD + integral",
    "torque": "torque feedback",
    "flatness": "flatness",
    "lqg": "LQG",
}
NUMBERS: tuple[tuple[str | None, str, str, bool, Callable[[Any], str]], ...] = (
    ("nominal", "remaining_median", "remains, median", False, lambda value: _milli(value)),
    ("nominal", "remaining_worst", "remains, worst", False, lambda value: _milli(value)),
    ("payload", "remaining_worst", "with the payload", False, lambda value: _milli(value)),
    ("sampled", "remaining_worst", "sampled robots", False, lambda value: _milli(value)),
    ("late", "remaining_worst", "second sample of latency", False, lambda value: _milli(value)),
    ("nominal", "wrong_way", "wrong way", False, lambda value: _percent(value)),
    ("nominal", "path", "off the path", False, lambda value: _milli(value)),
    ("nominal", "ripple", "ripple", False, lambda value: _percent(value)),
    ("nominal", "step_cpu", "CPU of a step", False, lambda value: _time(value, None)),
    (None, "damping", "damping", True, lambda value: _number(value)),
    (None, "fast", "damping of fast vibrations", True, lambda value: _number(value)),
    (None, "delay", "extra delay", True, lambda value: _margin(value, DELAYS)),
    (None, "damped_delay", "extra delay with damped springs", True, lambda value: _margin(value, DELAYS)),
    (None, "gain", "gain margin", True, lambda value: _margin(value, GAINS)),
    ("motors", "remaining_worst", "motor encoders alone", False, lambda value: _milli(value)),
    ("frictionless", "remaining_worst", "without dry friction", False, lambda value: _milli(value)),
    ("push", "peak", "peak of a push", False, lambda value: _milli(value)),
    ("push", "remaining_worst", "0.4 s after a push", False, lambda value: _milli(value)),
    ("steps", "wrong_way", "wrong way in bare steps", False, lambda value: _percent(value)),
    ("steps", "excursion", "others move in bare steps", False, lambda value: _percent(value)),
)


def better(folder: Path) -> str:
    """What a rival does better than the law for the workspace, by what is written: the best of them, and its number."""
    lines = _head("robot", "better", "a rival's number, flexhinf's")
    for robot in ROBOTS:
        found: dict[str, list[str]] = {}
        for condition, key, title, more, text in NUMBERS:
            values = {}
            for law in (OVER_ALL, *SHORT):
                row = (
                    _record(folder, robot, law) if condition is None else _row(folder, robot, law, condition)
                )
                if row is not None and row.get(key) is not None:
                    values[law] = row[key]
            mine = values.pop(OVER_ALL, None)
            best = max(values, key=lambda law: values[law] if more else -values[law], default=None)
            if mine is None or best is None:
                continue
            ahead = values[best] > mine if more else values[best] < mine
            if ahead and text(values[best]) != text(mine):
                found.setdefault(best, []).append(f"{title} ({text(values[best])}, {text(mine)})")
        name = _dated(folder, robot)
        lines += [_cells(name, SHORT[law], "; ".join(found[law])) for law in SHORT if law in found]
    return "\n".join(lines)


def _record(folder: Path, robot: str, law: str) -> dict[str, Any] | None:
    """Linear loops of a law that is stable at all poses."""
    record = kept(folder, law_name(robot, law, True))
    stable = record is not None and "refused" not in record and record["stable"] == record["poses"]
    return record if stable else None


def which(folder: Path) -> str:
    """Every law, over all robots of which it has the rows that the criterion reads."""
    lines = _head(
        "law", "all arrive: nominal, payload, sampled, second sample of latency", "damping of at least 0.2",
        "extra delay, gain", "ripple", "worst that remains, nominal: median of the robots", "a step of PD's",
    )  # fmt: skip
    for law, choice in LAWS.items():
        judged = [(robot, found) for robot in ROBOTS if (found := criterion(folder, robot, law)) is not None]
        if not judged:
            continue

        def count(*names: str, judged: Any = judged) -> str:
            return f"{sum(all(found[name][0] for name in names) for _, found in judged)}"

        late = [_row(folder, robot, law, "late") for robot, _ in judged]
        arrive = [count(f"arrive, {name}") for name in ("nominal", "payload", "sampled")]
        arrive.append(f"{sum(row is not None and row['arrived'] == row['moves'] for row in late)}")
        rows = [_row(folder, robot, law, "nominal") or {} for robot, _ in judged]
        units = [_row(folder, robot, PD, "nominal") for robot, _ in judged]
        steps = [row["step_cpu"] / unit["step_cpu"] for row, unit in zip(rows, units) if unit is not None]
        worst = [np.inf if row["remaining_worst"] is None else row["remaining_worst"] for row in rows]
        median = float(np.median(worst))
        lines.append(
            _cells(
                choice.title,
                f"{', '.join(arrive)} of {len(judged)} robots",
                count("damping"),
                count("extra delay", "extra delay with damped springs", "gain margin"),
                count("ripple"),
                _milli(median if np.isfinite(median) else None),
                f"{_digits(min(steps))} to {_digits(max(steps))}" if steps else MISSING,
            )
        )
    return "\n".join(lines)


def sensors(folder: Path) -> str:
    """What remains with encoders on both sides and with those of the motors alone: the product's law and PD."""
    lines = _head(
        "robot", "flexhinf, both encoders", "with the payload", "flexhinf, motors alone", "with the payload",
        "PD + gravity, motors alone", "with the payload", "what statics leave with the payload",
    )  # fmt: skip
    for robot in ROBOTS:
        rows = [
            _row(folder, robot, OVER_ALL, name) for name in ("nominal", "payload", "motors", "motors-payload")
        ]
        rows += [_row(folder, robot, PD, name) for name in ("nominal", "payload")]  # it reads no others
        if rows[0] is None:
            continue
        cells = [MISSING if row is None else _milli(row["remaining_worst"]) for row in rows]
        left = MISSING if rows[3] is None else _milli(rows[3]["statics"])
        lines.append(_cells(_dated(folder, robot), *cells, left))
    return "\n".join(lines)


# Tables -------------------------------------------------------------------------------------------


def moves(folder: Path) -> str:
    """Moves in MuJoCo's robot: how many arrive, and what remains."""
    lines = _head(
        "robot", "law", "arrive: nominal", "payload", "sampled robots", "second sample of latency",
        "remains: median, worst", "wrong way", "off the path", "ripple", "saturated",
    )  # fmt: skip
    for robot, law in _laws(folder, MUJOCO):
        row, others = _row(folder, robot, law, "nominal"), ("payload", "sampled", "late")
        arrive = [_arrive(row), *(_arrive(_row(folder, robot, law, name)) for name in others)]
        left, name = row["left_out"] if row else 0, _dated(folder, robot)
        name = f"{name} ({left} goals left out)" if left else name
        lines.append(_cells(name, LAWS[law].title, *arrive, *_numbers(row)))
    return "\n".join(lines)


def many(folder: Path) -> str:
    """Moves of the law for the workspace to more goals: how many arrive, and the worst that remains."""
    lines = _head(
        "robot", "arrive, worst that remains: nominal", "payload", "sampled robots", "second sample of latency",
        "wrong way: nominal", "payload", "sampled robots", "ripple, nominal",
    )  # fmt: skip
    for robot in ROBOTS:
        names = ("nominal", "payload", "sampled", "late")
        rows = [_row(folder / MANY, robot, OVER_ALL, name) for name in names]
        if any(row is not None for row in rows):
            keys = [(row, "wrong_way") for row in rows[:3]] + [(rows[0], "ripple")]
            others = [MISSING if row is None else _percent(row[key]) for row, key in keys]
            lines.append(_cells(robot, *map(_both, rows), *others))
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
                    _chosen(record.get("numbers", {})),
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
        "with the payload: worst that remains (what statics leave)",
        "without dry friction: arrive, worst that remains", "pushes: peak, back within 2 %, worst 0.4 s later",
        "bare steps: wrong way, others move",
    )  # fmt: skip
    for robot, law in _laws(folder, MUJOCO):
        free, push, steps, motors, loaded = (
            _row(folder, robot, law, name)
            for name in ("frictionless", "push", "steps", "motors", "motors-payload")
        )
        lines.append(
            _cells(
                robot,
                LAWS[law].title,
                "needs those of the links" if LAWS[law].needs_links else _both(motors),
                "" if LAWS[law].needs_links else _of_statics(loaded),
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
    "criterion": judgement,
    "better": better,
    "laws": which,
    "sensors": sensors,
    "gamma": gamma.table,
    "masses": masses.table,
    "moves": moves,
    "many": many,
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


def _dated(folder: Path, robot: str) -> str:
    """A robot's name, and whether the moves of its rows are from before laws fed dry friction forward."""
    row = _row(folder, robot, OVER_ALL, "nominal")
    return robot if row is None or row.get("fed_forward") else f"{robot} (before)"


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


def _chosen(numbers: dict[str, Any]) -> str:
    """What a rival was tuned to: its share or bandwidth, then what else was chosen."""
    texts = []
    if "share" in numbers:
        texts.append(f"{numbers['share']:g} ({numbers['fastest']:g} rad/s)")
    if "w" in numbers:
        texts.append(f"{numbers['w']:g} rad/s, velocities {numbers['velocity']:g}")
    if "turning" in numbers:
        fed = {"torque": numbers["lighter"] != 1.0, "its rate": numbers["turning"] != 0.0}
        texts.append(" and ".join(name for name, used in fed.items() if used))
    if "left" in numbers:
        texts.append("three poles and the vibration" if numbers["left"] else "five equal poles")
    if "torques" in numbers:
        texts.append("filter " + ", ".join(f"{100.0 * one:g} %" for one in numbers["torques"]))
    return "; ".join(texts)


def _of_statics(row: dict[str, Any] | None) -> str:
    """What remains, and what would if the motors stood where they should."""
    return MISSING if row is None else f"{_milli(row['remaining_worst'])} ({_milli(row['statics'])})"


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
