"""What is said of the moves of a proof."""

from types import SimpleNamespace

import numpy as np
from tests.refusals import unnamed

from flexhinf.certify.checker.moves import CheckedMoves
from flexhinf.designs.workspace.moves import ProvedMoves
from flexhinf.pages.workspace_proof import moves_text


def test_a_speed_of_moves_is_rounded_so_that_it_holds_and_what_limits_it_is_said():
    def text(joints=("hip", "lift"), **changed):
        robot = SimpleNamespace(
            joint_names=joints, links=SimpleNamespace(slides=(False, True)[: len(joints)])
        )
        moves = ProvedMoves(
            {},
            CheckedMoves(4.559, 1.0, 9.0, 3, 0),
            900.0,
            np.array([2.0, 0.5]),
            True,
            38.0,
            np.array([19.0, 5.0]),
            200,
        )
        moves = None if changed.get("moves", moves) is None else moves._replace(**changed)
        return moves_text(SimpleNamespace(setup=SimpleNamespace(robot=robot), checked=1, moves=moves))  # type: ignore

    assert (
        unnamed(text(), "4.55", "11.9 %", "hip", "0.479 rad/s", "200 sampled", "30 rad/s", "Coriolis") == []
    )
    assert (
        unnamed(text(poses=0, together=2.0, alone=np.array([1.0, 2.0])), "every pose", "227 %", "1.13 m/s")
        == []
    )
    assert "limit it" not in text(together=2.0)
    assert unnamed(text(has_limits=False), "0.119 rad/s or m/s") == []
    assert unnamed(text(together=0.0), "no joint") == []
    assert unnamed(text(moves=None), "nothing") == []
    assert text(("hip",)) == ""
