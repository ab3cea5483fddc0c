"""Memory is estimated before a solve and refused where it does not fit; a progress bar appears for long work."""

from __future__ import annotations

import sys
import tracemalloc

import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.hinf import hji as cost
from flexhinf.hinf import smallest_gamma, solve_hji
from flexhinf.plant import expansion
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.polynomial import basis, transform, truncated
from flexhinf.robot import paper_arm
from flexhinf.scalars import jet


def _plant(n: int) -> PolynomialPlant:
    rng = np.random.default_rng(n)
    f = {
        1: -np.eye(n) + 0.1 * rng.standard_normal((n, n)),
        2: 0.1 * rng.standard_normal((n, basis.count(n, 2))),
    }
    return PolynomialPlant.from_parts(
        n, f, {0: np.ones((n, 1, 1))}, {0: np.ones((n, 1, 1))}, {1: np.eye(n)}, np.eye(1)
    )


def test_estimate_covers_what_is_used_and_not_much_more():
    plant = _plant(17)
    tracemalloc.start()
    solution = solve_hji(plant, np.inf, 5)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert solution.memory == cost.estimate_memory(plant.size, 5)
    assert 0.5 * peak < solution.memory < 3 * peak + 2e7


#: Of the paper's arm, whose code is expanded, and of polynomial plants: degree, and states or none.
MEASURED = [
    (4, 16),
    *(pytest.param(*case, marks=pytest.mark.slow) for case in ((12, 8), (17, 5), (None, 18))),
]


@pytest.mark.parametrize(("states", "degree"), MEASURED)
def test_estimate_is_right_within_a_factor_of_two(arm, states, degree):
    for module in (basis, truncated, expansion, jet, transform):
        for function in vars(module).values():
            if hasattr(function, "cache_clear"):
                function.cache_clear()
    problem = arm if states is None else _plant(states)
    gamma = 2.0 * smallest_gamma(arm) if states is None else np.inf
    vars(problem).pop("_expansion", None)
    tracemalloc.start()
    solution = solve_hji(problem, gamma, degree)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert 0.5 * peak < solution.memory < 2.0 * peak + 2e7


def test_what_would_fit_once_only_is_refused(monkeypatch):
    problem, needed = paper_arm().problem(), cost.estimate_memory((5, 1, 1, 5), 12, expanded=True)
    monkeypatch.setattr(cost, "available_memory", lambda: int(1.9 * needed))
    with pytest.raises(
        InvalidInput, match=r"(?s)Degree 12 in 5 states.*GB are needed.*degree 1[01] is the highest"
    ):
        solve_hji(problem, 250.0, 12)
    monkeypatch.setattr(cost, "available_memory", lambda: int(2.1 * needed))
    assert solve_hji(problem, 250.0, 12).degree == 12


def test_degree_forty_of_one_link_is_refused_with_twenty_four_gigabytes(monkeypatch):
    """The solve takes nine; the expansion's index tuples in states, input and disturbance four more."""
    monkeypatch.setattr(cost, "available_memory", lambda: 24_000_000_000)
    with pytest.raises(
        InvalidInput, match=r"(?s)Degree 40 in 5 states.*about 13\.7 GB are needed, 24 GB are available"
    ):
        solve_hji(paper_arm().problem(), 250.0, 40)


def test_estimate_at_thirty_five_states_is_below_four_gigabytes():
    assert 1e9 < cost.estimate_memory((35, 7, 7, 35), 6) < 4e9


def test_refusal_names_need_and_supply_before_any_work():
    with pytest.raises(
        InvalidInput,
        match=r"(?s)Degree 30 in 35 states.*GB are needed.*available.*degree [5-9] is the highest",
    ):
        solve_hji(_plant(35), 2.0, 30)


def test_refusal_comes_before_the_expansion(arm, monkeypatch):
    monkeypatch.setattr(type(arm), "expand", lambda self, degree: pytest.fail("expanded first"))
    with pytest.raises(InvalidInput, match="Degree 200 in 5 states does not fit"):
        solve_hji(arm, 2.0, 200)


def test_supply_is_some_number():
    assert cost.available_memory() > 1e6


@pytest.mark.parametrize(
    ("terminal", "long", "shown"), [(True, True, True), (False, True, False), (True, False, False)]
)
def test_bar_only_on_a_terminal_and_for_long_work(monkeypatch, capsys, terminal, long, shown):
    monkeypatch.setattr(cost, "_LONG", 0.0 if long else 1e30)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal, raising=False)
    monkeypatch.setenv("FORCE_COLOR", "1")
    with cost.degree_progress(3, 4) as advance:
        advance(3)
        advance(4)
    assert ("degree 4 of 4" in capsys.readouterr().err) == shown
