"""What docs/augmentation.md says of its table; that the table is what the code makes, test_made_parts says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

LOAD, POWER_ON, STEP = 2, 3, 4

NOTHING = "nothing more (the design's filter)"


@pytest.fixture(scope="module")
def rows(repository: Path) -> dict[tuple[str, str], list[list[float]]]:
    """Numbers of each cell by sensors and what is estimated."""
    text = (repository / "docs" / "augmentation.md").read_text(encoding="utf-8")
    table = text.partition("<!-- made: augmentation -->")[2].partition("<!-- end -->")[0]
    lines = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in table.splitlines()
        if line.startswith("|")
    ]
    return {
        (cells[0], cells[1]): [[float(x) for x in re.findall(r"\d+\.?\d*", cell)] for cell in cells]
        for cells in lines[2:]
    }


def test_the_sag_of_motor_side_sensing_is_gone(rows) -> None:
    assert rows["motor", NOTHING][LOAD][1] > 3.0
    assert all(rows["motor", name][LOAD][1] < 0.1 for name in ("load", "load, balanced"))


@pytest.mark.parametrize("sensors", ["link", "motor", "both"])
def test_a_balanced_load_moves_the_link_less(rows, sensors) -> None:
    largest, effort = rows[sensors, NOTHING][LOAD][0], rows[sensors, NOTHING][LOAD][2]
    balanced = rows[sensors, "load, balanced"][LOAD]
    assert balanced[0] < 0.95 * largest
    assert balanced[2] < effort + 0.5


def test_what_a_link_encoder_sees_remains_nowhere(rows) -> None:
    for sensors in ("link", "both"):
        assert rows[sensors, NOTHING][LOAD][1] == rows[sensors, "load, balanced"][LOAD][1] == 0.0


def test_at_corners_a_fast_load_needs_the_stiffness_or_both_encoders(rows) -> None:
    fast = "load that drifts ten times faster, balanced"
    lost = {key: cells[STEP][3] for key, cells in rows.items()}
    assert lost["link", fast] > 0
    assert lost["both", fast] == lost["link", "stiffness and load, balanced"] == lost["link", NOTHING] == 0
    remains = [cells[STEP][1] for (sensors, _), cells in rows.items() if sensors == "motor"]
    assert min(remains) > 10.0


def test_an_offset_as_a_state_takes_the_jump_at_power_on_away(rows) -> None:
    for sensors in ("both", "motor"):
        at_once = rows[sensors, NOTHING][POWER_ON][0]
        assert rows[sensors, "offset of the motor's encoder"][POWER_ON][0] < 0.1 * at_once
        assert rows[sensors, "load, balanced"][POWER_ON][0] > 1.1 * at_once
    both = [rows["both", name][POWER_ON][0] for name in (NOTHING, "stiffness")]
    assert both[1] == pytest.approx(both[0], rel=0.05)  # a tie
