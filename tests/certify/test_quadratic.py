"""Linear laws with a V of degree two: definite matrices prove what cells prove, in rationals and without cells."""

from __future__ import annotations

import signal
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from importlib import import_module
from itertools import count
from typing import Any

import numpy as np
import pytest
from flint import arb, fmpq
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.certify import Certificate, Function, Term, checker
from flexhinf.certify.box import common_value, parameter_ranges, tolerance_statement
from flexhinf.certify.checker.residual import quotient_range
from flexhinf.certify.proof import certify_tolerances

from .test_checker import GRAVITY, LEVEL, V_2, uncertain, upright

quadratic = import_module("flexhinf.certify.checker.residual")

ARM = fh.paper_arm()


@cache
def whole_box(goal: int) -> Certificate:
    """The paper's arm with all tolerances, and a law with weights on all states."""
    pose = (np.radians(goal),)
    problem = ARM.problem(fh.Penalty((75.0, 27.0, 90.0, 27.0, 330.0), effort=10.0), pose=pose)
    solution = fh.solve_hji(problem, 1.5 * fh.smallest_gamma(problem), 2)
    measured = ARM.problem(pose=pose)
    ranges = parameter_ranges(ARM, measured.plant)
    found = common_value(tolerance_statement(solution, measured, ranges, 1.0))
    assert found is not None
    gamma = 1.02 * found.smallest
    return certify_tolerances(solution, measured, ranges, gamma, step=pose[0], p=found.p(1.02), most_cells=1)


@pytest.mark.parametrize("goal", ci_and_night("2,000 corners in rationals", [90], [180]))
def test_the_step_is_proved_for_all_tolerances_within_two_per_cent_of_the_matrices_gain(goal: int) -> None:
    found = whole_box(goal)
    again = found.check()
    assert again.proved
    assert again.corners == 2**10 * 2  # of the parameters, and of the sine's quotient
    assert again.cells == 0
    assert again.starts > 0
    assert found.step_amplitude > np.radians(goal)
    assert arb(found.step_amplitude) > arb.pi() * goal / 180  # which no double is


@pytest.mark.ci("a design for all tolerances")
def test_a_gain_that_no_quadratic_v_has_is_refused() -> None:
    assert not replace(whole_box(180), gamma=0.97 * whole_box(180).gamma).definite_corners()


@pytest.mark.oracle
@pytest.mark.parametrize("claim", [upright(level=LEVEL / 4), uncertain(0.01)], ids=["one", "a box"])
def test_cells_prove_what_definite_matrices_prove(claim: Certificate) -> None:
    quick, cells = claim.check(threads=1), claim.check(threads=1, sample=0, by_cells=True)
    assert quick.proved
    assert quick.corners == (2 if not claim.parameters else 8)
    assert cells.proved
    assert cells.corners == 0 < cells.cells
    assert quick.gradient_law == cells.gradient_law


FALL = Term(-GRAVITY, (0, 0), (), 0)
WRONG = {
    "gain": {"gamma": 1.05},
    "level": {"level": LEVEL},  # the quotient of the sine is too small so far out
    "reach": {"reach": 5.0},
    "V": {"value": tuple((powers, 0.9 * value) for powers, value in V_2)},
    "indefinite V": {"value": (((2, 0), -1.0), ((0, 2), 1.0))},
    "penalty": {"penalty": ((((1, 0), 12.0),),)},
    "decay": {"decay": 3.0},
    "no quadratic form": {"drift": ((Term(1.0, (0, 1)),), (FALL, Term(-1e-9, (0, 3))))},
    "no value": {"functions": (Function("log", (1.0, 0.0)),)},
}


@pytest.mark.parametrize("changes", WRONG.values(), ids=WRONG.keys())
def test_what_definite_matrices_do_not_show_is_left_to_the_cells(changes: dict) -> None:
    sound = upright(level=LEVEL / 4)
    assert sound.definite_corners() == 2
    assert replace(sound, **changes).definite_corners() == 0


@pytest.mark.parametrize("skipped", ["quotients", "parameters"])
def test_each_end_is_needed(skipped: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A claim that fails at one end alone is proved where that end is left out, and refused where it is not."""
    if skipped == "quotients":
        wrong = upright(level=LEVEL * 1.01)
        monkeypatch.setattr(quadratic, "quotient_range", lambda *given: (fmpq(-1), fmpq(-1)))
    else:
        wrong, corners = uncertain(0.2), quadratic.box_corners
        monkeypatch.setattr(quadratic, "box_corners", lambda *given: corners(*given)[:1])
    assert wrong.check(threads=1).proved
    monkeypatch.undo()
    assert not wrong.check(threads=1).proved


@pytest.mark.parametrize("last", [1, 20], ids=["while faces are handed out", "while they are awaited"])
def test_an_interrupted_check_ends_at_its_next_cells(last: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C reaches the main thread: the others, held until it leaves, do not go on to the end of their faces."""
    numbers, seen, left = count(1), list[int](), threading.Event()

    class Pool(ThreadPoolExecutor):
        def submit(self, *given: Any) -> Future[Any]:  # type: ignore[override]
            job = super().submit(*given)
            if last == 1:
                threading.Event().wait()  # for Ctrl-C
            return job

        def __exit__(self, *given: Any) -> bool | None:
            left.set()
            return super().__exit__(*given)

    def tick(cells: int) -> None:
        number = next(numbers)
        seen.append(number)
        if number == last:
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
        if number >= last:
            left.wait()

    monkeypatch.setattr(checker, "ThreadPoolExecutor", Pool)
    with pytest.raises(KeyboardInterrupt):
        upright(level=0.99 * LEVEL).check(threads=2, sample=None, tick=tick)
    assert last <= len(seen) <= last + 1  # of 70: one more where the other thread was at its cells


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "offset", "halves"),
    [("sin", 0.0, 2), ("cos", 0.3, 0), ("exp", -0.5, 0), ("tanh", 0.4, 0), ("log", 7.0, 0)],
)
def test_ranges_of_quotients_hold_all_values_and_little_more(name: str, offset: float, halves: int) -> None:
    found = quotient_range(Function(name, (1.0,), offset, halves), fmpq(9))
    assert found is not None
    s = np.linspace(-3.0, 3.0, 2001)
    s = s[s != 0.0]
    o, phi = offset + halves * np.pi / 2, getattr(np, name)
    exact = (phi(o + s) - phi(o)) / s
    low, high = (float(end.p) / float(end.q) for end in found)
    assert low <= exact.min()
    assert exact.max() <= high
    assert high - low < 1.05 * np.ptp(exact) + 0.02
    assert quotient_range(Function("log", (1.0,), 2.0), fmpq(9)) is None
