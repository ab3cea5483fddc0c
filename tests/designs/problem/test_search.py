"""What a search returns has what was asked for, in every member; what it refuses, it refuses with the best found."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with, unnamed

from flexhinf.analysis.modes import JointScales
from flexhinf.designs.problem.weights import (
    FITS,
    DampingOutOfReach,
    LinearFamily,
    LinearProblem,
    SearchResult,
    TargetBehaviour,
    behaviour_of,
    search,
)
from flexhinf.errors import InvalidInput, NoFeasibleGamma
from flexhinf.hinf import HJISolution

pytestmark = pytest.mark.oracle


class Case:
    """A robot's search for a share of its lowest vibration, and a damping."""

    def __init__(self, robot: Any) -> None:
        goal = np.array(robot.home)
        self.family = LinearFamily.of(robot, goal)
        self.scales = JointScales.of(robot.plant(), robot.operating_point(goal))

    def synthesis(self, pace: np.ndarray, damping: float | np.ndarray) -> tuple[HJISolution, float]:
        game = LinearProblem.of(self.family, self.scales.rows(pace, damping), True)
        star = game.gamma_star
        return game.design(1.5 * star), star

    def target(self, share: Any, damping: float) -> TargetBehaviour:
        return TargetBehaviour(
            np.broadcast_to(share * self.scales.antiresonance, (len(self.family.robot.joint_names),)).copy(),
            damping,
        )

    def search(self, share: Any, damping: float) -> SearchResult:
        return search(self.target(share, damping), self.family, self.synthesis, self.scales.antiresonance)


def smallest_damping(case: Case, gain: np.ndarray) -> float:
    """Of every oscillation of every member, straight from the eigenvalues; −1 where one grows."""
    values = np.linalg.eigvals(case.family.a + case.family.b @ gain).ravel()
    if values.real.max() >= 0.0:
        return -1.0
    pairs = values[values.imag > 0.0]
    return float((-pairs.real / np.abs(pairs)).min(initial=np.inf))


def check(case: Case, found: SearchResult, wanted: TargetBehaviour) -> None:
    """Damping by eigenvalues; bandwidths by the responses of python-control at the band's edge and inside."""
    import control

    gain, joints = found.chosen.design.gain, len(wanted.bandwidth)
    assert smallest_damping(case, gain) >= wanted.damping
    n = case.family.a.shape[1]
    command = np.vstack([np.zeros((n - joints, joints)), -np.eye(joints)])
    at_edge = []
    for a, b in zip(case.family.a, case.family.b):
        loop = control.ss(a + b @ gain, command, np.eye(joints, n), np.zeros((joints, joints)))
        for j, edge in enumerate(wanted.bandwidth):
            inside = edge * np.append(np.geomspace(1e-3, 1.0 - 2.0 * FITS, 40), 1.0 + 2.0 * FITS)
            sizes = np.abs(loop(1j * inside).reshape(joints, joints, -1)[j, j])
            assert sizes[:-1].min() >= np.sqrt(0.5)
            at_edge.append((j, sizes[-1]))
    for j in range(joints):
        assert min(size for joint, size in at_edge if joint == j) < np.sqrt(0.5)  # no faster than asked


@pytest.mark.ci("searches weights of many robots")
@pytest.mark.parametrize(
    ("name", "share", "damping"),
    [
        ("paper", 0.3, 0.2),
        ("paper stiffness*0.3", 0.4, 0.3),
        ("paper stiffness*3 motor_inertia*0.4", 0.2, 0.35),
        ("paper link_inertia*3 friction*3", 0.5, 0.35),
        ("quanser-rotflex", 0.3, 0.2),
        ("quanser-rotflex link_inertia*0.3", 0.25, 0.3),
        ("vertical-rig motor_inertia*3", 0.1, 0.35),
        ("cart", 0.4, 0.3),
        ("cart mass*2 stiffness*0.5", 0.2, 0.25),
        ("planar-two-link", 0.3, 0.2),
        ("planar-two-link mass*0.4", 0.15, 0.4),
        pytest.param("seven-link", 0.3, 0.2, marks=pytest.mark.nightly("seven links")),
    ],
)
def test_what_is_found_has_what_is_asked_for_and_no_larger_dial_than_needed(
    robot_of: Callable[[str], Any], name: str, share: float, damping: float
) -> None:
    case = Case(robot_of(name))
    found = case.search(share, damping)
    check(case, found, case.target(share, damping))
    assert found.chosen.damping_weight > 0.0
    assert found.candidates[0].damping_weight == 0.0
    assert smallest_damping(case, found.candidates[0].design.gain) < damping
    less, _ = case.synthesis(found.chosen.target_frequency, 0.9 * found.chosen.damping_weights)
    assert smallest_damping(case, less.gain) < damping


def test_where_no_dial_is_needed_none_is_turned(robot_of: Callable[[str], Any]) -> None:
    case = Case(robot_of("paper"))
    found = case.search(0.7, 0.05)
    assert found.chosen.damping_weight == 0.0
    assert len(found.candidates) == 1
    check(case, found, case.target(0.7, 0.05))


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("name", ["cart", "planar-two-link"])
def test_each_joint_gets_its_own_bandwidth(robot_of: Callable[[str], Any], name: str) -> None:
    case, shares = Case(robot_of(name)), np.array([0.15, 0.4])
    check(case, case.search(shares, 0.15), case.target(shares, 0.15))


def test_every_try_says_what_its_gain_does(robot_of: Callable[[str], Any]) -> None:
    case = Case(robot_of("quanser-rotflex"))
    found = case.search(0.3, 0.25)
    assert len(found.candidates) > 5
    for tried in found.candidates:
        assert smallest_damping(case, tried.design.gain) == pytest.approx(tried.behaviour.damping)
        again, _ = case.synthesis(tried.target_frequency, tried.damping_weight)
        assert again.gain == pytest.approx(tried.design.gain)
    assert any(tried is found.chosen for tried in found.candidates)


@pytest.mark.ci("searches weights of many robots")
@pytest.mark.parametrize(
    ("name", "share", "damping"),
    [
        ("paper", 0.5, 0.6),
        ("quanser-rotflex", 0.7, 0.5),
        ("planar-two-link", 0.5, 0.55),
    ],
)
def test_a_damping_out_of_reach_is_refused_with_the_best_and_the_best_is_true(
    robot_of: Callable[[str], Any], name: str, share: float, damping: float
) -> None:
    """A large damping weight makes a vibration slow and no vibration by name: it still counts."""
    case = Case(robot_of(name))
    with pytest.raises(DampingOutOfReach) as refused:
        case.search(share, damping)
    best = float(re.search(r"best .* is ([\d.]+) ", str(refused.value)).group(1))  # type: ignore[union-attr]
    assert 0.1 < best < damping
    found = case.search(share, 0.97 * best)
    check(case, found, case.target(share, 0.97 * best))
    advised = float(re.search(r"damping=([\d.]+)", str(refused.value)).group(1))  # type: ignore[union-attr]
    assert 0.9 * best < advised < best


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("name", ["paper", "planar-two-link"])
def test_a_bandwidth_out_of_reach_is_refused_with_the_best(robot_of: Callable[[str], Any], name: str) -> None:
    case = Case(robot_of(name))
    with pytest.raises(InvalidInput, match="bandwidth") as refused:
        case.search(12.0, 0.1)
    assert refused.type is InvalidInput  # and not for the damping
    text = str(refused.value)
    best = float(re.search(r"best .* is ([\d.]+) rad/s", text).group(1))  # type: ignore[union-attr]
    assert best < 12.0 * case.scales.antiresonance
    share = 0.9 * best / case.scales.antiresonance
    check(case, case.search(share, 0.0), case.target(share, 0.0))


@pytest.mark.ci("two more searches")
def test_a_family_that_is_more_uncertain_needs_a_larger_damping_weight(
    robot_of: Callable[[str], Any],
) -> None:
    """The worst member counts: the nominal robot alone needs a smaller damping weight."""
    robot = robot_of("quanser-rotflex")
    uncertain, certain = Case(robot), Case(robot)
    certain.family = LinearFamily.of(robot, np.array(robot.home), members=0)
    both = [case.search(0.3, 0.25).chosen for case in (uncertain, certain)]
    assert both[0].damping_weight > 1.1 * both[1].damping_weight
    assert behaviour_of(uncertain.family, both[1].design.gain).damping < 0.25


def test_a_bandwidth_that_no_loop_reaches_is_answered_with_a_number_to_try() -> None:
    """It said that the best found was 0 rad/s, and a smaller bandwidth."""

    def unsolvable(*weights: Any) -> Any:
        raise NoFeasibleGamma("none", "none", "none")

    family: Any = None
    with refused_with(InvalidInput, "bandwidth=12", 400, 40, 0.3) as caught:
        search(TargetBehaviour(np.array([400.0]), 0.2), family, unsolvable, 40.0)
    assert unnamed(str(caught.value), 0)
