"""Memory is estimated before a solve and refused where it does not fit; a progress bar appears for long work."""

from __future__ import annotations

import re
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.hinf import hji as cost, homological as transform, smallest_gamma, solve_hji
from flexhinf.plant import polynomial_plant as expansion
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.polynomial import basis, truncated
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
    *(pytest.param(*case, marks=pytest.mark.ci("a large solve")) for case in ((12, 8), (17, 5), (None, 18))),
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
    with refused_with(InvalidInput, "degree 12", "5 states", "GB") as caught:
        solve_hji(problem, 250.0, 12)
    assert re.search("degree 1[01] ", caught.value.advice)
    monkeypatch.setattr(cost, "available_memory", lambda: int(2.1 * needed))
    assert solve_hji(problem, 250.0, 12).degree == 12


def test_degree_forty_of_one_link_is_refused_with_fourteen_gigabytes(monkeypatch):
    """The solve takes three; the expansion's index tuples in states, input and disturbance four more."""
    monkeypatch.setattr(cost, "available_memory", lambda: 14_000_000_000)
    with refused_with(InvalidInput, "Degree 40", "5 states", "7.33 GB", "14 GB"):
        solve_hji(paper_arm().problem(), 250.0, 40)


def test_estimate_at_thirty_five_states_is_below_four_gigabytes():
    assert 1e9 < cost.estimate_memory((35, 7, 7, 35), 6) < 4e9


def test_refusal_names_need_and_supply_before_any_work():
    with refused_with(InvalidInput, "degree 30", "35 states") as caught:
        solve_hji(_plant(35), 2.0, 30)
    assert caught.value.found.count(" GB") == 2
    assert re.search("degree [5-9] ", caught.value.advice)


def test_refusal_comes_before_the_expansion(arm, monkeypatch):
    monkeypatch.setattr(type(arm), "expand", lambda self, degree: pytest.fail("expanded first"))
    with refused_with(InvalidInput, "Degree 200", "5 states", "memory"):
        solve_hji(arm, 2.0, 200)


def test_supply_is_some_number():
    assert cost.available_memory() > 1e6


LIMITED = """
import resource, flexhinf as fh
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 400_000_000,) * 2)
from flexhinf.hinf.hji import available_memory
assert available_memory() <= 400_000_000, available_memory()
try:
    fh.solve_hji(problem, 300.0, 32)
except fh.errors.InvalidInput as error:
    assert "Degree 32 " in str(error) and "memory" in str(error), error
    assert "degree " in error.advice, error
else:
    raise AssertionError("it was solved")
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux limits addresses so")
@pytest.mark.ci("a process of its own; control groups are quick")
def test_a_limit_of_the_process_is_known():
    """As `ulimit -v` sets it."""
    script = LIMITED.replace("import resource, flexhinf as fh", "import resource, flexhinf as fh\n"
                             "problem = fh.paper_arm().problem()")  # fmt: skip
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr[-2000:]


@pytest.mark.parametrize(
    ("files", "free"),
    [
        ({"memory.max": "max", "memory.current": "5000"}, None),
        ({"memory.max": "9000000", "memory.current": "5000000"}, 4_000_000),
        ({"a/b/memory.max": "9000000", "a/b/memory.current": "5000000"}, 4_000_000),
        ({"a/memory.max": "8000000", "a/memory.current": "7000000", "memory.stat": "inactive_file 3"}, 1_000_000),
        (
            {"a/b/memory.max": "9000000", "a/b/memory.current": "5000000", "a/b/memory.stat": "inactive_file 2000000"},
            6_000_000,
        ),
        ({"memory/memory.limit_in_bytes": "7000000", "memory/memory.usage_in_bytes": "5000000"}, 2_000_000),
        ({"memory/memory.limit_in_bytes": "5000000", "memory/memory.usage_in_bytes": "7000000"}, 1),
    ],
)  # fmt: skip
def test_a_limit_of_a_control_group_is_known(tmp_path, monkeypatch, files, free):
    """Of the group itself or of one above it, of version 2 or 1; pages of files that can be taken back are free."""
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text + "\n")
        (tmp_path / name).with_name("memory.stat").touch()
    own = tmp_path / "own"
    own.write_text("0::/a/b\n")
    monkeypatch.setattr(cost, "_CGROUPS", tmp_path)
    monkeypatch.setattr(cost, "_OWN_GROUPS", own)
    monkeypatch.setattr(cost, "_free_here", lambda: [1 << 40])
    assert cost.available_memory() == (1 << 40 if free is None else free)


def test_memory_that_ends_on_the_way_is_told(arm, monkeypatch):
    def none_left(*args, **options):
        raise MemoryError

    monkeypatch.setattr(cost, "solve_degrees", none_left)
    with refused_with(InvalidInput, "Degree 6", "5 states", "memory", "degree 4"):
        solve_hji(arm, 300.0, 6)


def test_what_leaves_the_floats_is_refused_too():
    with refused_with(InvalidInput, "Degree 200", "5000 states", "memory"):
        cost.check_cost((5000, 1, 1, 5000), 200)


def test_what_takes_days_is_refused_and_no_hours_are_advised(monkeypatch):
    """With memory for everything: the time is what is left, and the advice is minutes for both refusals."""
    monkeypatch.setattr(cost, "available_memory", lambda: 1 << 90)
    with refused_with(InvalidInput, "Degree 30", "35 states", "days") as late:
        cost.check_cost((35, 7, 7, 35), 30)
    assert re.search(r" day\b", late.value.found)
    (advised,) = re.findall(r"degree (\d+) ", late.value.advice)
    assert (
        60.0 < cost.total_work(35, int(advised)) / cost._RATE <= 600.0 < cost.total_work(35, int(advised) + 1)
    )
    monkeypatch.setattr(cost, "available_memory", lambda: 10 * cost.estimate_memory((35, 7, 7, 35), 12))
    with refused_with(InvalidInput, "Degree 30", "35 states", "memory") as large:
        cost.check_cost((35, 7, 7, 35), 30)
    assert f"degree {advised} " in large.value.advice


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
