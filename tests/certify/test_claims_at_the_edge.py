"""What the checker asks of a claim before it looks at cells: each limit from both sides, and what it reports."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from flint import ctx
from tests.refusals import unnamed

from flexhinf.certify import Certificate, Function, Parameter, Signal, Term, checker as checker_file
from flexhinf.certify.checker import _check_matrices, _check_sizes, _prove_again, verify
from flexhinf.certify.checker.bounds import BITS, Proof
from flexhinf.certify.checker.residual import Refusal
from flexhinf.certify.checker.second_route import ConfirmedCell

from .a_cubic import CUBIC
from .test_checker import LEVEL, uncertain, upright

SOUND = upright(level=LEVEL / 4)


def refused(check: Any, claim: Certificate) -> str:
    try:
        check(claim)
    except Refusal as refusal:
        return str(refusal)
    return ""


@pytest.mark.parametrize(
    ("inside", "outside", "reason"),
    [
        ({"level": 1e-100}, {"level": 9e-101}, " ends"),
        ({"reach": 1e-10}, {"reach": 9e-11}, " ends"),
        ({"reach": 1e10, "functions": (), "drift": ((), ())}, {"reach": 1.1e10}, " ends"),
        ({"reach": 999.0 / 0.13}, {"reach": 1001.0 / 0.13}, " 1000"),
        ({"functions": (Function("sin", (-128.0, 0.0)),)}, {"functions": (Function("sin", (-129.0, 0.0)),)}, "farther"),
        ({"functions": (Function("sin", (0.0, 24.0)),)}, {"functions": (Function("sin", (0.0, 25.0)),)}, "farther"),
    ],
)  # fmt: skip
def test_sizes_are_refused_beyond_their_limits(inside: Any, outside: Any, reason: str) -> None:
    assert refused(_check_sizes, replace(SOUND, **inside)) == ""
    assert reason in refused(_check_sizes, replace(SOUND, **outside))


def test_so_many_parameters_and_products_and_no_more() -> None:
    def claim(parameters: int, products: int, g: str = "drift") -> Certificate:
        box = tuple(Parameter(f"p{i}", 1.0, 2.0) for i in range(parameters))
        terms = tuple(Term(1.0, (1, 0), ((f"q{i}", 1),)) for i in range(products))
        known = tuple(Parameter(f"q{i}", 1.0, 1.0) for i in range(min(products, 20)))
        pairs = [(f"q{i}", 1) for i in range(len(known))]
        subsets = [tuple(p for k, p in enumerate(pairs[:7]) if number >> k & 1) for number in range(products)]
        terms = tuple(Term(1.0, (1, 0) if g == "drift" else (0, 0), subset) for subset in subsets)
        changed = {
            "drift": {"drift": ((Term(1.0, (0, 1)),), terms), "functions": ()},
            "g1": {"g1": (((),), (terms,))},
            "g2": {"g2": (((),), (terms,))},
        }[g]
        return replace(SOUND, parameters=(*box, *known), **changed)

    assert refused(_check_sizes, claim(12, 2)) == ""
    assert "13 parameters" in refused(_check_sizes, claim(13, 2))
    assert refused(_check_sizes, claim(0, 64)) == ""
    assert "65 different" in refused(_check_sizes, claim(0, 65))
    for g in ("g1", "g2"):
        assert refused(_check_sizes, claim(0, 62, g)) == ""
        assert "products" in refused(_check_sizes, claim(0, 70, g))


def test_matrices_are_what_the_theorem_asks_for() -> None:
    assert refused(_check_matrices, SOUND) == ""
    two = replace(
        SOUND, inputs=(Signal("a"), Signal("b")), g2=(((), ()), ((), ())), law=((), ()), r2=((1.0, 0.25), (0.25, 2.0))
    )  # fmt: skip
    assert refused(_check_matrices, two) == ""
    for r2 in (
        ((1.0, 0.25), (0.26, 2.0)),
        ((1.0, 0.0), (0.25, 2.0)),
        ((1.0, 2.0), (2.0, 1.0)),
        ((0.0, 0.0), (0.0, 1.0)),
    ):
        assert "R2 is " in refused(_check_matrices, replace(two, r2=r2))
    assert "singular" in refused(_check_matrices, replace(SOUND, coordinates=((1.0, 2.0), (2.0, 4.0))))
    assert "equilibrium" in refused(_check_matrices, replace(SOUND, shift=((0.0, 0.0), (0.0, 0.0))))


def test_what_is_reported_adds_up(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks: list[int] = []
    real, seen, samples = checker_file.subdivide_face, [], []

    def spied(*given: Any, **more: Any) -> Any:
        seen.append(real(*given, **more))
        samples.append(given[1].cells)
        return seen[-1]

    monkeypatch.setattr(checker_file, "subdivide_face", spied)
    found = verify(upright(level=0.98 * LEVEL), threads=1, sample=3, tick=ticks.append)
    assert found.proved
    assert found.reason == ""
    assert found.faces == len(seen) == 2
    for name in ("cells", "accepted", "with_level"):
        assert getattr(found, name) == sum(getattr(one, name) for one in seen) > 0
    assert sum(ticks) == found.cells
    assert found.rounding == max(one.rounding for one in seen) > 0
    assert found.resampled == sum(map(len, samples)) == 6
    assert (found.corners, found.starts, found.every_cell) == (0, 0, False)
    assert found.gradient_law
    assert 0 < found.cpu_s < 600
    wrong = verify(upright(level=1.01 * LEVEL), threads=1)
    assert (wrong.proved, wrong.cells, wrong.gradient_law, wrong.every_cell) == (False, 0, False, False)
    assert 0 <= wrong.cpu_s < 600


def test_every_cell_is_reported_as_such() -> None:
    found = verify(replace(SOUND, level=LEVEL / 16), threads=1, sample=None, by_cells=True)
    assert found.proved
    assert found.every_cell
    assert found.resampled > found.accepted
    few = verify(SOUND, threads=1, sample=2, by_cells=True)
    assert (few.resampled, few.every_cell) == (4, False)
    quick = verify(SOUND, threads=1)
    assert quick.proved
    assert (quick.corners, quick.cells, quick.faces, quick.resampled) == (2, 0, 0, 0)
    assert quick.gradient_law
    assert quick.cpu_s >= 0
    assert not verify(uncertain(0.01), threads=1).gradient_law
    assert verify(CUBIC, threads=1, sample=0).starts > 0


def test_a_sample_is_shown_at_both_ends_and_at_all_corners_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[ConfirmedCell, list[int]]] = []
    monkeypatch.setattr(
        checker_file, "confirm", lambda proof, cell, corners: asked.append((cell, list(corners)))
    )
    with ctx.workprec(BITS):
        proof = Proof(uncertain(0.04))
        uneven = Proof(upright(functions=(Function("exp", (0.1, 0.0)),)))
    cell = ConfirmedCell((0, 1), (0.25,), (0.25,), 1.0, 2.0, 0.0)
    assert proof.even
    assert _prove_again(proof, [cell] * 200, 3) == 200
    assert {one.face for one, _ in asked} == {(0, 1), (0, -1)}
    assert {tuple(corners) for _, corners in asked} == {(i,) for i in range(len(proof.exact_corners))}
    first = list(asked)
    asked.clear()
    _prove_again(proof, [cell] * 200, 3)
    assert asked == first
    asked.clear()
    assert not uneven.even
    _prove_again(uneven, [cell] * 50, 0)
    assert {one.face for one, _ in asked} == {(0, 1)}


def test_the_place_of_a_refusal_is_in_the_plant_s_own_states() -> None:
    claim = replace(SOUND, coordinates=((0.5, 0.25), (0.0, 2.0)))
    z = np.array([2.0, -1.0])
    text = checker_file._reason(claim, Refusal("r > 0", z, 3.25))
    assert unnamed(text, "r > 0", "angle = 0.75 rad", "rate = -2 rad/s", "V = 3.25", f"{LEVEL / 4:.6g}") == []
    assert checker_file._reason(claim, Refusal("no")) == "no."
