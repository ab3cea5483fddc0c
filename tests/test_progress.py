"""How far work is, by the names of its steps."""

from __future__ import annotations

from flexhinf.progress import Steps


def test_a_step_moves_to_its_place_and_never_back() -> None:
    """By the beginning or the end of its name; one that is not known stays, one that comes early skips the others."""
    work = Steps([("weights", 3.0), ("solve", 1.0), ("sample", 1.0), ("tune", 5.0)])
    assert work.total == 10.0
    assert [work.begin(name) for name in ("weights: 12 tried", "degree 2: solve", "else")] == [0.0, 3.0, 3.0]
    assert [work.begin(name) for name in ("pd: tune", "weights again")] == [5.0, 5.0]
    assert Steps(()).begin("anything") == Steps(()).total == 0.0
