"""Waypoints as people write them: units, orders and comments are read, and what is no motion is refused by its line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexhinf.designs import Specification
from flexhinf.robot.waypoints import WaypointError, WaypointTable, waypoints


def read(folder: Path, text: str) -> WaypointTable:
    file = folder / "way.csv"
    file.write_text(text, encoding="utf-8")
    found = Specification(move=str(file)).move
    assert isinstance(found, WaypointTable)
    return found


def test_units_comments_and_any_order_of_columns(tmp_path: Path) -> None:
    text = "# made by hand\ntime [ms], elbow (deg), link_position_belt [mm]\n500, 90, 0\n\n1500, -90, 250\n"
    found = read(tmp_path, text)
    assert found.times == (0.0, 1.0)
    both = found.positions(("belt", "elbow"), (True, False))
    np.testing.assert_allclose(both, [[0.0, np.pi / 2], [0.25, -np.pi / 2]])
    assert read(tmp_path, text.replace(",", ";")) == found


def test_columns_by_name_are_the_same_as_a_file(tmp_path: Path) -> None:
    columns = {"time": [0.0, 1.0], "shoulder": np.array([0.1, 0.2])}
    assert Specification(move=columns).move == read(tmp_path, "time,shoulder\n0,0.1\n1,0.2\n")
    assert waypoints(waypoints(columns)).columns() == {"time": [0.0, 1.0], "shoulder": [0.1, 0.2]}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "column 'time'"),
        ("shoulder\n0\n1\n", "column 'time'"),
        ("time,shoulder\n0,1\n", "two, .* 1 of 'time'"),
        ("time,shoulder\n0,1\n1,2,3\n", "line 3"),
        ("time,shoulder\n0,1\n\n1,x\n", "'x'.*'shoulder'.*line 4"),
        ("time,shoulder\n0,1\n1,1_0\n", "'1_0'.*'shoulder'.*line 3"),
        ("time,shoulder\n0,1\n1,nan\n", "nan.*'shoulder'.*line 3"),
        ("time,shoulder\n0,1\n1,1e999\n", "inf of 'shoulder'"),
        ("time,shoulder\n0,1\n2,1\n1,1\n", "1 s.* 2 s.*line 4"),
        ("time,shoulder\n0,1\n0,1\n", "0 s.* 0 s.*line 3"),
        ("time [h],shoulder\n0,1\n1,1\n", "unit .*'time', got 'h'"),
        ("time,shoulder [turns]\n0,1\n1,1\n", "unit .*'shoulder', got 'turns'"),
        ("time,shoulder,shoulder\n0,1,1\n1,1,1\n", "once.*'shoulder', 'shoulder'"),
        (
            "time,shoulder [deg],shoulder [rad]\n0,0,1\n1,1,1\n",
            r"'time'.*'shoulder \[deg\]', 'shoulder \[rad\]'",
        ),
        ("time,shoulder\n0,1\n1,1e308\n", "1e.30, .*got 1e.308 of 'shoulder'"),
        ("time,shoulder\n1e308,1\n-1e308,1\n", "1e.308.*'time'.*line 2"),
        (f"time,shoulder [{' ' * 20_000}x]y\n0,1\n1,x\n", r"'x'.*'shoulder \[ .*line 3"),
        (f"time,shoulder [{' ' * 20_000}x]\n0,1\n1,1\n", "unit .*'shoulder', got 'x'"),
        (f"time,{'[' * 20_000}]\n0,1\n1,x\n", r"'x'.*'\[.*line 3"),
        (f"time,shoulder{' ' * 20_000}[\n0,1\n1,x\n", r"'x'.*'shoulder .*line 3"),
    ],
)
def test_what_is_no_motion_is_refused(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(WaypointError) as refused:
        read(tmp_path, text)
    found = " ".join(str(refused.value).split())

    assert re.search(message, found), found
    assert refused.value.advice


@pytest.mark.parametrize(
    "value",
    [
        3,
        [1.0, 2.0],
        "",
        {"time": [0.0, 1.0], "a": [0.0]},
        {1: [0.0, 1.0], "time": [0.0, 1.0]},
        {"time": [0, 1], "a": [0, True]},
        {"time": np.array([False, True]), "a": (0.0, 1.0)},
    ],
)
def test_what_is_no_table_is_refused(value: Any) -> None:
    with pytest.raises(ValueError, match=r"move|waypoints"):
        Specification(move=value)


@pytest.mark.parametrize(
    ("heading", "message", "advice"),
    [
        ("time,shoulder,elbw", "column 'elbw'", "'elbow'"),
        ("time,shoulder,link_position_shoulder", r"column(?s:.)*'elbow'\] once", "elbow"),
        ("time,shoulder,elbow [mm]", "unit .*'elbow'", r"elbow [rad]"),
    ],
)
def test_columns_that_are_not_the_joints_are_refused(
    heading: str, message: str, advice: str, tmp_path: Path
) -> None:
    found = read(tmp_path, f"{heading}\n0,0,0\n1,1,1\n")
    with pytest.raises(WaypointError, match=message) as refused:
        found.positions(("shoulder", "elbow"), (False, False))
    assert advice in refused.value.advice
