"""Proofs for every robot within its tolerances."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from flint import arb
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.certify.box import parameter_groups, parameter_ranges, tolerance_statement
from flexhinf.certify.certificate import path_states
from flexhinf.certify.inequality import BoxExcess
from flexhinf.certify.proof import NotProved, certify_tolerances, prove
from flexhinf.certify.starts import UNCHANGED_INPUT
from flexhinf.designs.problem.presets import choose
from flexhinf.designs.specification import Specification
from flexhinf.errors import InvalidInput

from .a_cubic import CUBIC

ARM = fh.paper_arm()
WEIGHTS = (80.0, 36.0, 120.0, 36.0, 340.0)
CHECKED = fh.Penalty((60.0, 0.0, 0.0, 0.0, 300.0), effort=10.0)


@cache
def solution(goal: int, degree: int) -> fh.HJISolution:
    problem = ARM.problem(fh.Penalty(WEIGHTS, effort=10.0), pose=(np.radians(goal),))
    return fh.solve_hji(problem, gamma=1.5 * fh.smallest_gamma(problem), degree=degree)


@cache
def problem(goal: int, torques: bool = False):
    pose = (np.radians(goal),)
    if not torques:
        return ARM.problem(CHECKED, pose=pose)
    channels = ("link_torque", "motor_torque")
    return ARM.plant().with_objective(CHECKED, integrate=("link_position",), pose=pose, disturbances=channels)


def ranges(scale: float = 1.0) -> dict[str, tuple[float, float]]:
    return parameter_ranges(ARM, problem(180).plant, scale)


def residual(found, about, points: np.ndarray, values: dict[str, float], gamma: float) -> np.ndarray:
    """r in doubles from the plant's own code, in deviations from the robot's own equilibrium; its law is linear, or the
    equilibrium stays."""
    table = about.plant.parameters
    p = table.replaced(values).vector()
    x0, u0 = np.asarray(about.operating_point), np.asarray(about.operating_input)
    d = np.zeros(len(about.disturbance_names))

    def rates(x, u, d):
        return np.asarray(about.flow(x, u, d, table.named(p)), dtype=float)

    base, result = rates(x0, u0, d), []
    for x in points:
        u = np.atleast_1d(found.law(x))
        slope = found.gradient(x)
        closed = rates(x0 + x, u0 + u, d) - base
        g1 = np.array([rates(x0, u0, e) - base for e in np.eye(len(d))]).T
        h = about.expand(1).h_parts[1] @ x
        along = slope @ g1
        result.append(slope @ closed + 0.5 * h @ h + 0.5 * u @ about.r2 @ u + 0.5 * along @ along / gamma**2)
    return np.array(result)


@pytest.mark.ci("points of boxes for two laws")
@pytest.mark.parametrize(("goal", "degree", "torques"), [(90, 2, False), (180, 4, True)])
def test_no_robot_of_the_box_has_a_larger_residual(goal: int, degree: int, torques: bool) -> None:
    found, about, gamma, count = solution(goal, degree), problem(goal, torques), 20.0, 40
    statement = tolerance_statement(found, about, ranges(), gamma)
    rng = np.random.default_rng(0)
    face = rng.integers(0, 10, count)
    t, half = rng.uniform(-1, 1, (4, count)), 10.0 ** rng.uniform(-4, -1, (4, count))
    low = rng.uniform(0, 30, count) * rng.integers(0, 2, count)
    high = low + 10.0 ** rng.uniform(-3, 0.5, count)
    bound, _ = BoxExcess(statement, 60.0)(face, t, half, low, high)
    middle = {p.name: p.middle for p in statement.parameters}
    closest = np.full(count, -np.inf)
    for _ in range(16):
        radius = np.maximum(low + (high - low) * rng.uniform(0, 1, count), 1e-3)
        at = t + half * rng.uniform(-1, 1, t.shape)
        z = np.array([np.insert(at[:, i], face[i] // 2, 1 - 2 * (face[i] % 2)) for i in range(count)])
        points = (z * radius[:, None]) @ np.array(statement.coordinates).T
        corner = {p.name: (p.low, p.high)[rng.integers(2)] for p in statement.parameters}
        change = residual(found, about, points, corner, gamma) - residual(found, about, points, middle, gamma)
        closest = np.maximum(closest, change / radius**2 / bound)
    assert closest.max() < 1.0
    assert np.median(closest[half.max(axis=0) < 0.01]) > 0.3  # and the bound is no idle one


def test_products_of_parameters_are_one_variable_each() -> None:
    groups = parameter_groups(tolerance_statement(solution(180, 2), problem(180), ranges(), 20.0))
    assert {frozenset(group) for group in groups} == {
        frozenset(names)
        for names in (
            ("mass", "length", "gravity"), ("resistance", "torque_constant"), ("stiffness",), ("link_inertia",),
            ("motor_inertia",), ("friction",), ("back_emf_constant",),
        )
    }  # fmt: skip


def test_a_box_of_one_state_is_proved_up_to_its_own_level() -> None:
    found, outcome = prove(replace(CUBIC, starts=()))
    assert outcome.proved
    assert outcome.cells > 0
    assert found.check().proved
    assert not prove(replace(CUBIC, starts=(), level=0.126))[1].proved  # past x² = 0.25 at the upper end


def test_ranges_are_the_tolerances_of_the_tables() -> None:
    found = ranges()
    assert found["stiffness"] == pytest.approx((88.0, 112.0))
    assert found["stiffness"][0] < 88.0
    assert found["stiffness"][1] > 112.0
    assert ranges(0.1)["mass"] == pytest.approx((0.995, 1.005))


@pytest.mark.parametrize(
    ("goal", "share", "step"),
    ci_and_night("cells of boxes of parameters", [(90, 0.02, 0.15)], [(180, 0.02, 0.2)]),
)
def test_a_part_of_the_tolerances_is_proved_with_plain_weights_and_the_whole_is_refused(
    goal: int, share: float, step: float
) -> None:
    found, gamma = solution(goal, 2), 1.8 * solution(goal, 2).gamma
    proved = certify_tolerances(found, problem(goal), ranges(share), gamma, step=step)
    assert proved.step_amplitude == math.nextafter(step, math.inf)
    assert [start.rule for start in proved.starts] == [UNCHANGED_INPUT]
    with pytest.raises(NotProved):
        certify_tolerances(found, problem(goal), ranges(), gamma, step=step, most_cells=20_000)


@pytest.mark.ci("cells of a box of parameters")
def test_the_input_of_each_robot_does_not_jump_at_its_start() -> None:
    found, about = solution(90, 2), problem(90)
    proved = certify_tolerances(found, about, ranges(0.02), 1.8 * found.gamma, step=0.15)
    (start,) = proved.starts
    rng = np.random.default_rng(1)
    for _ in range(5):
        values = {p.name: float(rng.uniform(p.low, p.high)) for p in proved.parameters}
        x = path_states(start, values, np.array([0.12]))[0]
        known = values | {"inductance": 0.1}
        at, before = (ARM.operating_point((np.pi / 2 - a,), parameters=known) for a in (0.0, 0.12))
        assert x[:4] == pytest.approx(np.asarray(before[0]) - np.asarray(at[0]), abs=1e-12)
        assert found.law(x) == pytest.approx(np.asarray(before[1]) - np.asarray(at[1]), abs=1e-9)


def test_numbers_have_their_units() -> None:
    statement = tolerance_statement(solution(90, 2), problem(90), ranges(), 20.0)
    assert [signal.unit for signal in statement.disturbances] == ["rad"]
    assert {p.name: p.unit for p in statement.parameters}["stiffness"] == "N·m/rad"


@pytest.mark.ci("a proof of its own")
def test_a_nonlinear_law_needs_an_equilibrium_that_stays() -> None:
    tolerance_statement(solution(180, 4), problem(180), ranges(), 20.0)
    with pytest.raises(InvalidInput, match="equilibrium"):
        tolerance_statement(solution(90, 4), problem(90), ranges(), 20.0)


# The theorems of the paper's arm ------------------------------------------------------------------------
@pytest.mark.nightly("the theorems of the pages; tests/cli/test_certify.py proves a shorter step")
@pytest.mark.parametrize(
    ("goal", "damping", "gamma", "level"), [(180, 0.4, 380.0, 225_000.0), (90, None, 242.0, 22_600.0)]
)
def test_a_step_without_a_jump_is_proved_for_the_whole_tolerances(
    goal: int, damping: float, gamma: float, level: float
) -> None:
    """Definite matrices prove the largest level that they can, and cells the one of this step: 50 s of CPU each."""
    pose = np.radians([goal])
    s = Specification(pose=tuple(pose), start=(0.0,), preset="robust", damping=damping)
    chosen = choose(ARM, pose, np.zeros(1), s)
    found = fh.solve_hji(chosen.problem, gamma=chosen.gamma, degree=2)
    settings = {"solution": found, "problem": chosen.nominal, "ranges": ranges(), "gamma": gamma}
    largest = certify_tolerances(**settings, step=float(pose[0]), scale=4.0)
    proved = certify_tolerances(**settings, level=level, scale=4.0)
    for claim in (largest, proved):
        assert arb(claim.step_amplitude) > arb.pi() * goal / 180
    assert largest.level > 30.0 * proved.level
    for claim, by_cells in ((largest, False), (proved, True)):
        again = claim.check(threads=1, by_cells=by_cells)
        assert again.proved, again.reason
        assert (again.cells > 0) == by_cells
        assert again.starts > 0
        assert not again.gradient_law  # the input matrix is uncertain
        assert not replace(claim, gamma=0.5 * claim.gamma, starts=()).check(sample=0).proved
    with pytest.raises(NotProved):  # not with a storage function that leaves no room
        certify_tolerances(**settings, step=float(pose[0]), scale=1.0, most_cells=200_000)
