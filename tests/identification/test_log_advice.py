"""Advice of a log's refusals is followed: the log is then read, or the next refusal is another one."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.errors import InvalidInput

PLANT = fh.paper_arm().plant(("motor_position", "link_position"))
HEAD = "time,motor_voltage,motor_position,link_position\n"
ROWS = "".join(f"{0.01 * k:g},1,{2 + k},3\n" for k in range(10))
GERMAN = HEAD.replace(",", ";") + ROWS.replace(",", ";")
UNITS = HEAD.replace("time", "t_ms").replace("motor_position", "motor_position_deg") + ROWS

#: What an advice says of a file, and how a user follows it.
EDITS: dict[str, Callable[[str], str]] = {
    "one value for each column": lambda text: text.rstrip("\n") + ",3\n",
    "other names in the file": lambda text: text.replace("\n", "_second\n", 1),
    "leave the row out": lambda text: "".join(text.splitlines(keepends=True)[:-1]),
    "sort the rows, and drop repeated times": lambda text: "".join(text.splitlines(keepends=True)[:-1]),
    "a decimal point": lambda text: re.sub(r"(\d),(\d)", r"\1.\2", text),
    "0.5, or an empty cell": lambda text: re.sub(r"fast|inf", "", text),
    "two logs: the first 10 rows": lambda text: "".join(text.splitlines(keepends=True)[:11]),
    "times of the day as 23:59:59.5": lambda text: re.sub(r"12:00 PM,(\d)", r"12:00:0\1,1", text),
    "dates as 2026-01-31T12:00:00.5": lambda text: re.sub(r"(\d\d)/(\d\d)/(\d{4}) ", r"\3-\1-\2T", text),
    "a log of some seconds": lambda text: HEAD + ROWS,
    "a column 'time [ns]'": lambda text: HEAD + ROWS,
    "a header 'time,motor_torque": lambda text: HEAD + ROWS,
    "the same text, saved in UTF-8": lambda text: text,
}


def followed(advice: str, text: str, options: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """The file and the options after the advice."""
    for words, edit in EDITS.items():
        if words in advice:
            return edit(text), options
    found = re.match(r"(columns|time|units|hold_inputs|delays)=(\{[^}]*\}|'[^']*'|True)", advice)
    if found is None:  # a name in the place of another one, or a unit of a column
        quoted = re.match(r"'([^']*)'", advice)
        assert quoted, advice
        wrong = options.get("columns", {})
        if "time" in options:
            return text, {"time": quoted[1]}
        signal, column = next(iter(wrong.items()))
        known = signal in ("motor_voltage", *PLANT.outputs)
        return text, {"columns": {signal: quoted[1]} if known else {quoted[1]: column}}
    value = ast.literal_eval(found[2].replace("UNIT", "s" if found[1] == "time" else "deg"))
    if isinstance(value, dict):
        value = {**options.get(found[1], {}), **value}
    return text, {**options, found[1]: value}


def refused(file: Path, options: dict[str, Any]) -> InvalidInput | None:
    """The refusal of a log, None where it is read."""
    try:
        fh.read_log(file, PLANT, **options)
    except InvalidInput as error:
        return error
    return None


@pytest.mark.parametrize(
    ("text", "options"),
    [
        ("", {}),
        (HEAD, {}),
        (HEAD + ROWS + "0.05,1,2,3\n", {}),
        (HEAD + ROWS + "11,1,2,3\n", {}),
        (HEAD + ROWS + ",1,2,3\n", {}),
        (HEAD + ROWS + "0.2,1,fast,3\n", {}),
        (HEAD + ROWS + "0.2,1,3\n", {}),
        (HEAD + ROWS + "0.2,,2,3\n", {}),
        (GERMAN + "0.2;1;2,5;3\n", {}),
        (GERMAN + "0,2;1;2;3\n", {}),
        (HEAD.replace("motor_voltage", "volts") + ROWS, {}),
        (HEAD.replace("link_", "lnk_") + ROWS, {}),
        (HEAD.replace("time", "tme") + ROWS, {}),
        (HEAD.replace("time", "Zeit") + ROWS, {}),
        (UNITS, {}),
        (HEAD.replace("time", "clock [us]") + ROWS, {}),
        (HEAD + ROWS, {"time": "tiem"}),
        (HEAD + ROWS, {"columns": {"motor_position": "motr_position"}}),
        (HEAD + ROWS, {"columns": {"motor_positon": "motor_position"}}),
        (HEAD.replace("\n", ",measured/link_position\n") + ROWS.replace("\n", ",4\n"), {}),
        (HEAD.replace("\n", ",motor_position\n") + ROWS.replace("\n", ",4\n"), {}),
        (
            HEAD.replace("\n", ",pos,pos\n") + ROWS.replace("\n", ",4,5\n"),
            {"columns": {"link_position": "pos"}},
        ),
        (HEAD.replace("\n", ",time\n") + ROWS.replace("\n", ",4\n"), {}),
        (ROWS, {}),
        ("Rig 3\n\n" + HEAD + ROWS, {}),
        (HEAD.replace("time", "stamp.sec,stamp.nanosec") + ROWS.replace(",1,", ",5,1,"), {}),
        (HEAD + "".join(f"12:00 PM,{k},2,3\n" for k in range(5)), {}),
        (HEAD + "".join(f"10/27/2024 12:00:0{k},1,2,3\n" for k in range(5)), {}),
    ],
)
def test_advice_leads_on(tmp_path: Path, text: str, options: dict[str, Any]) -> None:
    file, seen = tmp_path / "log.csv", list[str]()
    file.write_text(text, encoding="utf-8")
    while (refusal := refused(file, options)) is not None:
        assert str(refusal) not in seen, refusal
        seen.append(str(refusal))
        text, options = followed(refusal.advice, text, options)
        file.write_text(text, encoding="utf-8")
    assert 1 <= len(seen) <= 4


def test_degrees_and_milliseconds_are_advised_as_such(tmp_path: Path) -> None:
    """The advice for a name that ends with a unit has the unit: followed, it gives the right numbers."""
    (tmp_path / "log.csv").write_text(UNITS, encoding="utf-8")
    with pytest.raises(InvalidInput) as raised:
        fh.read_log(tmp_path / "log.csv", PLANT)
    assert raised.value.advice == "time='t_ms [ms]'"
    with pytest.raises(InvalidInput) as raised:
        fh.read_log(tmp_path / "log.csv", PLANT, time="t_ms [ms]")
    assert raised.value.advice == "columns={'motor_position': 'motor_position_deg [deg]'}"


def test_a_column_whose_name_is_no_letter_is_advised_too(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(UNITS.replace("t_ms", "\u202e", 1), encoding="utf-8")
    with pytest.raises(InvalidInput) as raised:
        fh.read_log(tmp_path / "log.csv", PLANT)
    assert r"time='\u202e" in raised.value.advice


DEG = 180.0 / math.pi
SPELLED = [
    *((name, 1e3) for name in (
        "time_msec", "time_MS", "timeMs", "t_millis", "time_milliseconds", "ms", "time/ms", "millis", "stamp-ms",
    )),
    ("time_usec", 1e6), ("time_min", 1 / 60), ("time_0.1ms", 1e4), ("time_seconds", 1.0),
    *((f"motor_voltage{end}", 1e3) for end in ("_mv", "_millivolt", "/mV", "Mv")), ("mV", 1e3),
    ("motor_voltage_MV", None),
    *((f"motor_position{end}", DEG) for end in ("_degree", "_degrees", "Deg", "/deg", "°", " [degrees]")),
    ("deg_motor_position", DEG), ("motor_position_rev", 0.5 / math.pi), ("position [rev]", 0.5 / math.pi),
    ("motor_position_urad", 1e6), ("motor_position_gon", DEG / 0.9),
    ("motor_position_grad", None), ("motor_position_counts", None), ("timems", None), ("motor_current_mA", None),
    ("motor_current", None),
]  # fmt: skip


@pytest.mark.parametrize(("name", "size"), SPELLED)
def test_units_as_people_spell_them(tmp_path: Path, name: str, size: float | None) -> None:
    """The first advice to the letter gives the right number; None: it asks for the unit, or another column."""
    quantity = "motor_voltage" if "A" in name or "current" in name else "time"
    si = {"time": 0.01, "motor_voltage": 3.0, "motor_position": 0.5, "link_position": 0.25}
    for other, words in (("motor_voltage", "mV|voltage"), ("motor_position", "position")):
        quantity = other if re.search(words, name) else quantity
    head = ",".join(name if column == quantity else column for column in si)
    values = {column: value * (size or 1.0) if column == quantity else value for column, value in si.items()}
    rows = [",".join(repr(v * k if c == "time" else v) for c, v in values.items()) for k in range(5)]
    (tmp_path / "log.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    options: dict[str, Any] = {}
    refusal = refused(tmp_path / "log.csv", options)
    if refusal is not None:
        found = re.match(r"(columns|time)=(\{[^}]*\}|'[^']*')", refusal.advice)
        asks = ("[UNIT]", "COLUMN")
        assert (size is None) == any(word in refusal.advice for word in asks), refusal.advice
        if size is None or found is None:
            return
        options = {found[1]: ast.literal_eval(found[2])}
    log = fh.read_log(tmp_path / "log.csv", PLANT, **options)
    read = [log.times[1], log.inputs[0, 0], *log.outputs[0]]
    np.testing.assert_allclose(read, list(si.values()), rtol=1e-9)


def test_text_that_is_no_utf_8_is_said_in_english(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes((HEAD.replace("time", "time [°]") + ROWS).encode("latin-1"))
    with pytest.raises(InvalidInput) as raised:
        fh.read_log(tmp_path / "log.csv", PLANT)
    assert unnamed(raised.value.what, "log.csv", "UTF-8") == []
