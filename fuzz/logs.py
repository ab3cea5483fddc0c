"""Logs as CSV with other units, stamps, separators, gaps, and with cells, lines and bytes that do not belong there.

Each attempt writes a log, damages it or not, and compares what is read with its own reading of the same text in
fractions. What the text does not say without doubt must be refused; what is whole must not.
"""

from __future__ import annotations

import re
import tempfile
from fractions import Fraction
from pathlib import Path

import numpy as np

from flexhinf.identification import Log, read_log
from flexhinf.robot import paper_arm
from fuzz.tally import Tally

ATTEMPTS = 2000

#: Names of the plant's signals, and units of their columns with what one is in the SI unit.
SIGNALS = {
    "motor_voltage": {"": 1, "V": 1, "mV": Fraction(1, 1000), "kV": 1000},
    "motor_position": {"": 1, "rad": 1, "mrad": Fraction(1, 1000), "deg": Fraction(np.pi) / 180},
    "link_position": {"": 1, "rad": 1, "°": Fraction(np.pi) / 180},
}
STAMPS = {"": 1, "s": 1, "ms": Fraction(1, 10**3), "us": Fraction(1, 10**6), "ns": Fraction(1, 10**9)}
CELLS = (
    "nan", "NaN", "", "null", "-", "inf", "-inf", "1e400", "-1e400", "1e31", "1_0", "0x10", "٣", "½", "1.2.3", "1,5",
    "fast", '"', '"1"', "\x00", "\u202e", "1e-400", "--1", "+.5", "5.", "1e", "True", "9" * 400, "a" * 300,
)  # fmt: skip
HEADS = (
    "time",
    "motor_position",
    "motor_position [N]",
    "",
    "state.link_velocity [rpm]",
    "link_position [",
    "\u202e",
)
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,4})?", re.ASCII)


def drawn(rng: np.random.Generator) -> tuple[list[list[str]], str]:
    """The cells of a log that is whole, the header first, and what separates them."""
    unit = str(rng.choice(list(STAMPS)))
    first = int(rng.choice([0, 1530821160])) * 10**9
    steps = np.cumsum(rng.integers(10**6, 10**8, int(rng.integers(3, 12)))).tolist()
    head, columns = [f"time [{unit}]" if unit else "time"], [[]]
    for step in steps:
        stamp = Fraction(first + step, 10**9) / STAMPS[unit]
        whole, part = divmod(stamp.numerator * 10**9 // stamp.denominator, 10**9)
        columns[0].append(str(whole) if unit == "ns" else f"{whole}.{part:09d}")
    for name, units in SIGNALS.items():
        unit = str(rng.choice(list(units)))
        head.append(f"{name} [{unit}]" if unit else name)
        values = [f"{value:.{rng.integers(1, 17)}g}" for value in rng.normal(size=len(steps))]
        if name != "motor_voltage" and rng.random() < 0.5:
            values[1:] = [value if rng.random() < 0.7 else "" for value in values[1:]]
        columns.append(values)
    order = [int(k) for k in rng.permutation(len(head))]
    rows = [[head[k] for k in order], *([columns[k][i] for k in order] for i in range(len(steps)))]
    return rows, str(rng.choice([",", ";", "\t"]))


def damaged(rows: list[list[str]], separator: str, rng: np.random.Generator) -> bytes:
    """The text of a log with something in it that does not belong there."""
    rows, kind = [list(row) for row in rows], int(rng.integers(7))
    line, column = int(rng.integers(1, len(rows))), int(rng.integers(len(rows[0])))
    if kind == 0:
        rows[line][column] = str(rng.choice(CELLS))
    elif kind == 1:
        rows[0][column] = str(rng.choice(HEADS))
    elif kind == 2:
        rows.insert(line, rows[int(rng.integers(1, len(rows)))])
    elif kind == 3:
        del rows[line][column]
    elif kind == 4:
        rows = [[cell for k, cell in enumerate(row) if k != column] for row in rows]
    text = ("\r\n" if kind == 5 else "\n").join(separator.join(row) for row in rows).encode()
    if kind == 6:
        place = int(rng.integers(len(text)))
        return text[:place] + bytes(rng.integers(0, 256, 2, dtype=np.uint8)) + text[place + 1 :]
    return text


def meaning(text: str) -> dict[str, list[Fraction | None]] | None:
    """Values by signal, in SI units, times from 0 on; None where the text does not say them without doubt."""
    lines = [
        line for line in text.replace("\r\n", "\n").split("\n") if line.strip() and not line.startswith("#")
    ]
    lines = [re.sub('"([^",;\t]*)"', r"\1", line) for line in lines]
    if '"' in text.replace('"1"', "") or not lines:
        return None
    separator = max(";\t,", key=lines[0].count)
    head, *rows = ([cell.strip() for cell in line.split(separator)] for line in lines)
    found: dict[str, list[Fraction | None]] = {}
    for name, units in {"time": STAMPS, **SIGNALS}.items():
        places = [k for k, cell in enumerate(head) if cell == name or cell.startswith(f"{name} [")]
        unit = head[places[0]][len(name) + 2 : -1] if len(places) == 1 else "?"
        if unit not in units or any(len(row) != len(head) for row in rows):
            return None
        cells = [row[places[0]] for row in rows]
        missing = [cell.casefold() in ("", "nan", "null", "-") for cell in cells]
        if not all(gap or NUMBER.fullmatch(cell) for gap, cell in zip(missing, cells)):
            return None
        size = units[unit]
        if name == "time" and not unit and not any(missing):  # since 1970: the size says the unit
            long = len(str(int(abs(Fraction(cells[0])))))
            size = STAMPS[{12: "ms", 13: "ms", 15: "us", 16: "us", 18: "ns", 19: "ns"}.get(long, "s")]
        values = [None if gap else Fraction(cell) * size for gap, cell in zip(missing, cells)]
        if any(value is not None and abs(value) > 10**30 for value in values):
            return None
        found[name] = values
    times = found["time"]
    if len(times) < 3 or None in times or None in found["motor_voltage"]:
        return None
    if any(column.count(None) == len(column) for column in found.values()):
        return None
    found["time"] = [time - times[0] for time in times]  # type: ignore[operator]
    return found


def fault(log: Log, text: str) -> str:
    """What is wrong with a log that was read of a text; empty where nothing is."""
    known = meaning(text)
    if known is None:
        return "read what is not whole"
    columns = (log.times, log.inputs[:, 0], log.outputs[:, 0], log.outputs[:, 1])
    for name, column in zip(("time", *SIGNALS), columns):
        expected = [np.nan if value is None else float(value) for value in known[name]]
        if not np.allclose(column, expected, rtol=1e-14, atol=1e-300, equal_nan=True):
            return f"{name}: {column.tolist()} instead of {expected}"
    return ""


def run(attempts: int, seed: int = 0) -> Tally:
    """Try so many logs, half of them whole."""
    tally, plant = Tally("logs as CSV: units, stamps, gaps, damage"), paper_arm().plant(tuple(SIGNALS)[1:])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        for attempt in range(attempts):
            rng = np.random.default_rng([seed, attempt])
            rows, separator = drawn(rng)
            whole = attempt % 2 == 0
            text = (
                "\n".join(separator.join(row) for row in rows).encode()
                if whole
                else damaged(rows, separator, rng)
            )
            path.write_bytes(text)
            how = f"seed {seed}, attempt {attempt}"
            try:
                log = read_log(path, plant)
            except Exception as error:
                if whole:
                    tally.answered(f"refused what is whole: {error}", how)
                else:
                    tally.raised(error, how)
                continue
            tally.answered(fault(log, text.decode("utf-8")), how)
    return tally
