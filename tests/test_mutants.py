"""What the trial of changed sources relies on: notes of places, shares of rooms, the order of tests."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

from fuzz import reach
from fuzz.mutants import reached_by, room_of, sample_of, tally

SOURCE = """
SIZE = 3

def sign(x):
    if x > 0:
        return 1
    elif x < 0:
        return -1
    return [
        0
        for _ in range(SIZE)
    ]
"""


def test_places_are_noted_as_they_are_reached_and_lines_stay() -> None:
    reach.reached.clear()
    names: dict[str, object] = {}
    exec(compile(reach.marked(SOURCE, [(2, 0), (6, 1), (7, 2), (8, 3), (10, 4)]), "sign.py", "exec"), names)
    sign = names["sign"]
    assert callable(sign)
    assert reach.reached == set()  # what is computed on import is not noted
    for x, value, places in ((1, 1, {1}), (-1, -1, {2, 3}), (0, [0] * 3, {2, 4})):
        reach.reached.clear()
        assert sign(x) == value
        assert reach.reached == places
    assert sign.__code__.co_firstlineno == 4
    reach.reached.clear()


def test_every_room_has_its_share() -> None:
    files = {"src/flexhinf/hinf/a.py": 700, "src/flexhinf/loop/b/c.py": 290, "src/flexhinf/files.py": 10}
    changes = [({"file": file, "line": k}, str) for file, count in files.items() for k in range(count)]
    drawn = sample_of(changes, 100, 1)
    assert drawn == sample_of(changes, 100, 1)
    assert drawn != sample_of(changes, 100, 2)
    counts = Counter(room_of(change["file"]) for change, _ in drawn)
    assert counts.total() == 100
    assert counts["(top)"] == 3
    assert counts["hinf"] > 2 * counts["loop"] > 40


def test_cheap_tests_come_first_and_failing_ones_tell_nothing(tmp_path: Path) -> None:
    rows = [
        ("tests/hinf/test_a.py::test_dear[1]", 3.0, "passed", [1]),
        ("tests/hinf/test_a.py::test_dear[2]", 3.0, "passed", [2]),
        ("tests/loop/test_b.py::test_cheap", 0.1, "passed", [1]),
        ("tests/loop/test_b.py::test_broken", 0.1, "failed", [1]),
    ]
    kept = tmp_path / "reach.jsonl"
    keys = ("test", "cost", "ended", "places")
    kept.write_text("".join(json.dumps(dict(zip(keys, row))) + "\n" for row in rows), encoding="utf-8")
    found = reached_by(kept)
    assert found.of(1, "hinf") == ["tests/loop/test_b.py::test_cheap", "tests/hinf/test_a.py::test_dear"]
    assert found.of(2, "loop") == ["tests/hinf/test_a.py::test_dear"]
    assert found.of(9, "loop") == ["tests/loop/test_b.py::test_cheap"]  # on import: all of the room


def test_what_has_no_time_left_is_no_survivor() -> None:
    ended = {
        json.dumps({"file": "src/flexhinf/hinf/a.py", "line": k}): how
        for k, how in enumerate(["survived", "out of time", "too slow", "tests/a.py::test", "not run: …"])
    }
    found = tally(ended)["hinf"]
    assert (found["survived"], found["out of time"], found["too slow"], found["killed"]) == (1, 1, 1, 1)
