"""Findings about signals that are late, early, or of the other sign: logs that are likelier, with what to do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from flexhinf.identification.doctor.finding import LogFinding
from flexhinf.identification.log import FileColumn
from flexhinf.plant import Plant

if TYPE_CHECKING:  # it searches, with all that this needs
    from flexhinf.identification.alternatives import Alternative


def alternative_advice(
    other: Alternative,
    plant: Plant,
    late: Mapping[str, int] | None = None,
    columns: Mapping[str, FileColumn] | None = None,
) -> str:
    """What to try where a log with a signal at another time, or of another sign, is likelier.

    `late`: samples by which signals were stated late when the log was read: the latency of inputs, delays of sensors.
    `columns`: of the log's file.
    """
    if other.kind == "sign":
        column = (columns or {}).get(other.signal, FileColumn(other.signal))
        stated = f'--column "{other.signal}={column.name} [{-column.size:.6g}]"'
        return f"To try: {other.signal} times −1: `{stated}`."
    if other.kind == "moving":
        return (
            "To try: a log with a row whenever the input changes, or the mean of the input between two rows."
        )
    is_input, stated_late = other.signal in plant.inputs, (late or {}).get(other.signal, 0)
    samples = stated_late + round(other.samples)
    if samples >= 0:
        option = f"--latency {samples}" if is_input else f"--sensor-delay {other.signal}={samples}"
        return f"To try: `{option}`{f' in the place of {stated_late}' if stated_late else ''}."
    rows = f"{-samples} row{'s' if samples < -1 else ''}"
    first = f"{'`--latency 0`' if is_input else 'no `--sensor-delay` of it'}, and " if stated_late else ""
    where, again = ("up", "later") if is_input else ("down", "earlier")
    return (
        f"To try: {first}the column of {other.signal} moved {where} by {rows} in the file, beside all others, as no "
        f"option does it: each row gets the value that stood {rows} {again}. Leave out the "
        f"{'last' if is_input else 'first'} {rows}, where then none stands."
    )


def likelier_finding(
    other: Alternative,
    plant: Plant,
    late: Mapping[str, int] | None = None,
    columns: Mapping[str, FileColumn] | None = None,
) -> LogFinding:
    """The log that is likelier, as a finding; arguments as of `alternative_advice`."""
    column = (columns or {}).get(other.signal, FileColumn(other.signal))
    return LogFinding(
        other.kind,
        "fault" if other.kind == "sign" else "doubt",
        f"{other.text[0].upper()}{other.text[1:]}.",
        alternative_advice(other, plant, late, columns),
        other.signal,
        column.name,
    )
