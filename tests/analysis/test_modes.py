"""Modes by name: closed forms of two masses on a spring."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import flexhinf as fh
from flexhinf.analysis.linear_loop import DiscreteSystem
from flexhinf.analysis.modes import Mode, closed_loop, modes_of, stiffness_and_inertia

pytestmark = pytest.mark.oracle


def test_two_masses_on_a_spring_vibrate_as_in_the_textbook() -> None:
    robot = fh.load_robot("quanser-rotflex").with_values({"friction": 0.0, "back_emf_constant": 0.0})
    plant, rest = robot.plant(), robot.operating_point()
    _, inertia, _ = energy = stiffness_and_inertia(plant, rest)
    link, motor = 1.90e-3, 2.58e-3
    assert np.diag(inertia) == pytest.approx([link, motor])
    free, *vibration = modes_of(plant.linearise(*rest)[0], robot.joint_names, *energy)
    assert free.name == "free motion"
    assert vibration[-1].name == "vibration"
    assert vibration[-1].frequency == pytest.approx(
        np.sqrt(1.248 * (1 / link + 1 / motor)) / (2 * np.pi), rel=1e-9
    )
    assert vibration[-1].damping == 0.0  # old code had the eigenvalue's rounding, 1e-16
    assert vibration[-1].time_constant is None


@pytest.mark.quick_cases(7)
@pytest.mark.parametrize("name", sorted(fh.catalogue()))
@pytest.mark.parametrize("period", [None, 1e-3, pytest.param(1e-4, marks=pytest.mark.ci("one more period"))])
def test_springs_without_damping_have_a_damping_ratio_of_zero_and_no_rounding(
    name: str, period: float | None
) -> None:
    """Old code printed −6.4e-16. A real damping, however small, is no rounding."""
    robot = fh.load_robot(name)
    n = len(robot.joint_names)
    energy = stiffness_and_inertia(robot.plant(), robot.operating_point())
    stiffness, inertia = np.diag(energy[0]), energy[1]
    springs = np.block(
        [[stiffness, -stiffness], [-stiffness, 2.0 * stiffness]]
    )  # motors held by springs as well
    order = np.r_[:n, 2 * n : 3 * n, n : 2 * n, 3 * n : 4 * n]  # q, θ, q̇, θ̇ as q, q̇, θ, θ̇

    def damping(time: float) -> list[float]:
        pull, drag = -np.linalg.solve(inertia, springs), -np.linalg.solve(inertia, time * springs)
        a = np.block([[np.zeros((2 * n, 2 * n)), np.eye(2 * n)], [pull, drag]])[np.ix_(order, order)]
        if period is not None:
            return [DiscreteSystem(expm(a * period), a, a, a, period).damping[0]]
        return [mode.damping for mode in modes_of(a, robot.joint_names, *energy)]

    assert set(damping(0.0)) == {0.0}
    assert min(damping(1e-6)) > 1e-9


def test_the_papers_arm_swings_as_one_and_vibrates() -> None:
    robot = fh.paper_arm()
    plant, rest = robot.plant(), robot.operating_point()
    modes = modes_of(plant.linearise(*rest)[0], robot.joint_names, *stiffness_and_inertia(plant, rest))
    assert [mode.name for mode in modes] == ["swing", "vibration"]
    assert modes[1].frequency == pytest.approx(2.28, abs=0.005)


def test_each_vibration_of_two_links_is_told_at_its_joint() -> None:
    robot = fh.load_robot("planar-two-link")
    plant, rest = robot.plant(), robot.operating_point()
    modes = modes_of(plant.linearise(*rest)[0], robot.joint_names, *stiffness_and_inertia(plant, rest))
    assert [mode.joint for mode in modes if mode.vibration] == ["shoulder", "elbow"]


def test_a_mode_that_grows_has_negative_damping_and_a_name_of_its_own() -> None:
    grows = Mode(complex(3.0, 4.0), True, "elbow")
    assert grows.damping == pytest.approx(-0.6)
    assert grows.time_constant == pytest.approx(1 / 3)
    assert not grows.stable
    assert Mode(complex(2.0, 0.0), False, "elbow").name == "fall"


def test_an_upright_arm_falls_without_control_and_not_with_it() -> None:
    robot = fh.load_robot("spatial-three-link")
    problem = robot.problem()
    energy = stiffness_and_inertia(problem.plant, robot.operating_point())
    x, u = robot.operating_point()
    assert "fall" in {m.name for m in modes_of(problem.plant.linearise(x, u)[0], robot.joint_names, *energy)}
    law = fh.linear_law(problem, gamma=1.5 * fh.smallest_gamma(problem))
    e = law.expansion
    gain = -np.linalg.solve(e.r2, e.g2_parts[0][:, :, 0].T @ law.P)
    assert all(m.stable for m in modes_of(closed_loop(problem, gain), robot.joint_names, *energy))
