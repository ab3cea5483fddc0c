"""Columns of a log that are numbered through, q1 to q7, as those of the joints of a robot in their order."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from flexhinf.errors import refuse_if
from flexhinf.identification.log_heading import Heading, NamedColumn
from flexhinf.identification.log_units import is_other
from flexhinf.plant import Plant
from flexhinf.robot.table import name_and_unit
from flexhinf.validation import value_text

#: By unit, how the columns of a quantity are called, beside its own words.
CALLED = {
    "N·m": ("tau", "torque", "effort", "trq", "t", "m"),
    "V": ("voltage", "volt", "u", "v"),
    "A": ("current", "i"),
    "rad": ("q", "position", "pos", "angle", "theta"),
    "rad/s": ("dq", "qd", "velocity", "vel", "speed"),
}

_NUMBER = re.compile(r"\d+")


def expanded_columns(heading: Heading, plant: Plant, columns: Mapping[str, str]) -> dict[str, str]:
    """The columns of signals one by one: {"link_position": "q# [deg]"} stands for those of all joints, in their order.

    Raises InvalidInput: the file has not as many numbered columns of that name as the plant has such signals.
    """
    found, every = dict[str, str](), _series(heading.columns)
    for name, text in columns.items():
        signals = [one for one in (*plant.inputs, *plant.outputs) if one.startswith(f"{name}_")]
        if "#" not in str(text) or heading.named(text) or not signals:
            found[name] = text
            continue
        stem, unit = name_and_unit(text)
        series = every.get(stem, [])
        refuse_if(
            len(series) != len(signals),
            f"{heading.file.path.name} has no column for each signal of {name!r}.",
            f"expected {len(signals)} columns {value_text(stem, 60)} with a number for #, got "
            f"{value_text([column.name for column in series], 200)}",
            f"columns={{{signals[0]!r}: COLUMN}}, and so on for each",
        )
        found |= {
            signal: f"{column.name} [{unit}]" if unit else column.name
            for signal, column in zip(signals, series)
        }
    return found


def advised_series(signals: Sequence[str], free: Sequence[NamedColumn], plant: Plant) -> dict[str, str]:
    """Columns as `expanded_columns` reads them, where exactly one series of numbered columns fits each quantity of the
    signals, the first two words of their names; else none."""
    quantities: dict[str, list[str]] = {}
    for name in signals:
        quantities.setdefault("_".join(name.split("_")[:2]), []).append(name)
    series, found = _series(free), dict[str, str]()
    for quantity, names in quantities.items():
        si = plant.unit(names[0])
        fitting = [
            stem
            for stem, columns in series.items()
            if len(columns) == len(names) > 1
            and {*re.split(r"[^a-z]+", stem.casefold())} & {*CALLED.get(si, ())}
            and not any(is_other(column.name, column.unit, names[0], si) for column in columns)
        ]
        if len(fitting) != 1 or fitting[0] in found.values():
            return {}
        found[quantity] = fitting[0]
    return found


def _series(columns: Sequence[NamedColumn]) -> dict[str, list[NamedColumn]]:
    """Columns by what their names have in common, with # for their last number, in the order of that number."""
    series: dict[str, list[tuple[int, NamedColumn]]] = {}
    for column in columns:
        numbers = list(_NUMBER.finditer(column.name))
        if numbers and len(numbers[-1][0]) < 4:
            start, end = numbers[-1].span()
            stem = f"{column.name[:start]}#{column.name[end:]}"
            series.setdefault(stem, []).append((int(numbers[-1][0]), column))
    return {
        stem: [column for _, column in sorted(members, key=lambda member: member[0])]
        for stem, members in series.items()
        if len({number for number, _ in members}) == len(members)
    }
