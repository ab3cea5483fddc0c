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


@pytest.mark.parametrize("columns", [None, {"motor_position": "motor_position_deg"}])
def test_degrees_and_milliseconds_behind_names_are_read(
    tmp_path: Path, columns: dict[str, str] | None
) -> None:
    """And said: a note for each."""
    (tmp_path / "log.csv").write_text(UNITS, encoding="utf-8")
    log = fh.read_log(tmp_path / "log.csv", PLANT, columns)
    assert log.times == pytest.approx(1e-5 * np.arange(10))
    assert log.outputs[1] == pytest.approx([np.deg2rad(3.0), 3.0])
    assert {(one.signal, one.severity) for one in log.findings} == {
        ("time", "note"),
        ("motor_position", "note"),
    }


def test_stamps_of_two_columns_keep_every_digit(tmp_path: Path) -> None:
    """Seconds since 1970 and nanoseconds, as bags are exported; of a prefix, of either name, or of none."""
    rows = "".join(f"{1700000000 + k // 4},{250_000_001 * (k % 4)},1,2,3\n" for k in range(12))
    for start in ("header.stamp.", "/joint_states/header/stamp/", "stamp_"):
        for ends in (("sec", "nanosec"), ("secs", "nsecs")):
            head = HEAD.replace("time", ",".join(f"{start}{end}" for end in ends))
            (tmp_path / "log.csv").write_text(head + rows, encoding="utf-8")
            for time in (None, f"{start}{ends[0]}", start.rstrip("./_")):
                log = fh.read_log(tmp_path / "log.csv", PLANT, time=time)
                assert log.times[:6].tolist() == pytest.approx(
                    [0.0, 0.250000001, 0.500000002, 0.750000003, 1.0, 1.250000001], abs=1e-12
                )


def test_columns_of_a_file_without_header_are_stated_by_their_numbers(tmp_path: Path) -> None:
    """As MATLAB writes a matrix; also with decimal commas."""
    matrix = "".join(f"{0.01 * k:.7e},{k},1,{2 + k / 4}\n" for k in range(10))
    columns = {"motor_voltage": "3", "motor_position": "4 [deg]", "link_position": "2"}
    for text in (matrix, matrix.replace(",", ";").replace(".", ",")):
        (tmp_path / "log.csv").write_text(text, encoding="utf-8")
        log = fh.read_log(tmp_path / "log.csv", PLANT, columns, time="1")
        assert log.times == pytest.approx(0.01 * np.arange(10))
        assert log.outputs[1] == pytest.approx([np.deg2rad(2.25), 1.0])


def turning(tmp_path: Path, stamps: np.ndarray, motor: np.ndarray, link: np.ndarray) -> Path:
    columns = np.column_stack([stamps, np.ones(len(stamps)), motor, link])
    np.savetxt(tmp_path / "log.csv", columns, "%.12g", ",", header=HEAD.strip(), comments="")
    return tmp_path / "log.csv"


@pytest.mark.parametrize(
    ("modulus", "count"), [(2.0 * np.pi, 1.0), (360.0, np.pi / 180.0), (65536.0, 1e-4), (4096.0, 1e-3)]
)
@pytest.mark.parametrize("rate", [0.02, 0.2])
def test_turns_and_counters_go_on_counting_where_it_is_stated(
    tmp_path: Path, modulus: float, count: float, rate: float
) -> None:
    """At a fifth of a turn a row too; in whatever unit, and whole numbers of a counter."""
    turns = rate * np.arange(400) + 0.1 * np.sin(0.05 * np.arange(400))
    written = modulus * turns
    if modulus == round(modulus) and modulus > 1000.0:
        written = np.rint(written)
    file = turning(tmp_path, 0.01 * np.arange(400), written % modulus, np.sin(0.1 * np.arange(400)))
    columns = {"motor_position": f"motor_position [{count!r}]"}
    plain = fh.read_log(file, PLANT, columns)
    assert [one.kind for one in fh.examine(plain) if one.severity == "fault"] == ["turns"]
    log = fh.read_log(file, PLANT, columns, unwrap="motor_position")
    assert np.diff(log.outputs[:, 0]) == pytest.approx(count * np.diff(written), abs=1e-6 * count * modulus)
    assert [one.kind for one in fh.examine(log) if one.severity == "fault"] == []


def test_a_counter_of_times_goes_on_counting(tmp_path: Path) -> None:
    """The refusal names it; 32 bits of microseconds are full after 71 minutes."""
    stamps = (2.0**32 - 4e6 + 1e4 * np.arange(1000)) % 2.0**32
    file = turning(tmp_path, stamps, np.arange(1000.0), np.arange(1000.0))
    with pytest.raises(InvalidInput) as raised:
        fh.read_log(file, PLANT, time="time [us]")
    assert raised.value.advice == "unwrap=('time',)"
    log = fh.read_log(file, PLANT, time="time [us]", unwrap="time")
    assert log.times == pytest.approx(0.01 * np.arange(1000))


def test_values_that_stand_for_none_and_repeated_ones_are_none(tmp_path: Path) -> None:
    motor = np.where(np.arange(60) % 20 == 7, -9999.0, np.sin(0.1 * np.arange(60)))
    link = np.repeat(np.arange(12.0), 5)
    file = turning(tmp_path, 0.01 * np.arange(60), motor, link)
    log = fh.read_log(file, PLANT, missing=-9999, repeated="link_position")
    assert np.flatnonzero(np.isnan(log.outputs[:, 0])).tolist() == [7, 27, 47]
    assert np.flatnonzero(np.isfinite(log.outputs[:, 1])).tolist() == list(range(0, 60, 5))


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
