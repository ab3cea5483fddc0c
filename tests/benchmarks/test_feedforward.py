"""``python -m benchmarks.feedforward``: a row at small size, resumed; what paths and the table say."""

from __future__ import annotations

import json

import numpy as np
import pytest
from benchmarks import feedforward


def test_a_jerk_limited_move_takes_its_time_with_the_smallest_jerk():
    """Its jerk is ±32 d / T³, the bound of a move of the distance d in the time T with rest at both ends."""
    move = feedforward.Move(np.array([0.1, -0.2]), np.array([1.1, 0.3]), 1.024)
    path, period = move.jerk_limited(), feedforward.PERIOD
    assert path[round(1.024 / period) + 1] == pytest.approx(move.goal, abs=1e-9)
    assert path[0] == pytest.approx(move.start, abs=1e-5)
    jerk = np.diff(path, 3, axis=0)[:, 0] / period**3
    assert np.abs(jerk).max() == pytest.approx(32.0 / 1.024**3, rel=1e-6)


@pytest.mark.ci("simulates moves on MuJoCo")
def test_a_row_is_kept_and_not_made_again(tmp_path, monkeypatch, capsys):
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    words = ["--times", "1.0", "--moves", "1", "--kept", str(tmp_path / "rows.json")]
    assert feedforward.main(words) == 0
    rows = json.loads((tmp_path / "rows.json").read_text(encoding="utf-8"))
    plain, shaped, smooth = (
        rows[f"1 s: {way}"] for way in ("feedforward", "shaped by pose, feedforward", "jerk-limited")
    )
    for row in (plain, shaped):
        assert row["as stated"][1] < 0.05 < smooth["as stated"][1]
    assert shaped["springs 20 % softer"][1] < 0.5 * plain["springs 20 % softer"][1]

    def again(*arguments):
        raise AssertionError("it is kept")

    monkeypatch.setattr(feedforward, "made", again)
    assert feedforward.main(words) == 0
    capsys.readouterr()
    assert feedforward.main([*words, "--table"]) == 0
    cells = [cell.strip() for cell in capsys.readouterr().out.splitlines()[2].split("|")]
    assert cells[1:4] == ["1 s", "feedforward", str(plain["rate"])]


def test_what_is_too_short_is_refused(capsys):
    with pytest.raises(SystemExit):
        feedforward.main(["--times", "0.3"])
    assert "0.5" in capsys.readouterr().err
