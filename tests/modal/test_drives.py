"""The pair of a drive with an inner loop, and its law for a whole arm."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from tests.builders import driven_robot

import flexhinf as fh
from flexhinf.modal import ModalLaw
from flexhinf.modal.pair import Pair, PairWeights, pair_gains
from flexhinf.plant import Penalty

WEIGHTS = PairWeights(bandwidth=14.0, share=1.0, integral=0.5, gamma=1.5)


def test_a_pair_is_its_equations():
    """z″ = λ (w − z + d_z), w″ = −κ (w − z) − β w′ − ν w + b (f + d_w)."""
    pair = Pair(400.0, 250.0, 30.0, 7000.0, 500.0)
    a, b, g = pair.matrices
    z, dz, w, dw, _ = x = np.array([0.3, -0.1, 0.2, 0.7, 0.4])
    rates = a @ x + b[:, 0] * 0.6 + g @ [0.05, 0.02]
    motor = -250.0 * (w - z) - 30.0 * dw - 7000.0 * w + 500.0 * 0.62
    assert rates == pytest.approx([dz, 400.0 * (w - z + 0.05), dw, motor, z])
    assert Pair(400.0, 250.0, 30.0).matrices[1][3, 0] == 250.0


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("share", [1.0, 0.0])
def test_gains_damp_the_vibration_of_pairs_of_position_drives(share):
    """The vibration with the drive alone is damped by less than 0.1 over the range of λ; with the gains by 0.3."""
    omega, gain = 2.0 * np.pi * 20.0, 600.0
    gains = pair_gains((100.0, 2000.0), share * gain, 1.8 * omega, 1e-3, WEIGHTS, omega**2, gain)
    assert gains.sweep[0] < 1.0
    assert gains.sweep[1] > 0.3
    a = gains.pair(300.0).matrices[0][:4, :4]
    alone = np.linalg.eigvals(a)
    alone = alone[np.abs(alone.imag) > 2.0]
    assert (-alone.real / np.abs(alone)).min() < 0.1
    # an independent route to the sampled loop: the exponential of the whole
    k = gains(300.0)[:5]
    pair = gains.pair(300.0)
    a, b, _ = pair.matrices
    whole = expm(1e-3 * np.block([[a, b], [np.zeros((1, 6))]]))
    loop = whole[:5, :5] - np.outer(whole[:5, 5], k)
    assert np.sort(np.abs(np.linalg.eigvals(loop))) == pytest.approx(np.sort(np.abs(pair.modes(k, 1e-3))))


@pytest.mark.quick_cases(1)
@pytest.mark.costs("the law of one robot, traced with its inverse mass matrix")
@pytest.mark.parametrize("share", [1.0, 0.0])
def test_the_law_of_an_arm_is_that_of_its_pairs_where_drives_are_alike(share):
    """For alike drives the closed loop of the arm has the modes of its pairs; and the code gives the slope."""
    robot = driven_robot("planar-two-link", "position", (20.0, 20.0), share)
    p = robot.plant_parameters()
    rates = (p["stiffness"] / p["motor_inertia"])[0], (p["friction"] / p["motor_inertia"])[0]
    elbow = p["motor_inertia"][1]
    robot = robot.with_values({"stiffness_elbow": rates[0] * elbow, "friction_elbow": rates[1] * elbow})
    law = ModalLaw.tuned(robot.problem(penalty=Penalty({"link_position": 1.0})), 1e-3, WEIGHTS)
    pose = np.array([0.4, -0.9])
    slope = law.slope_at(pose)
    x, u = robot.operating_point(pose)
    a, b, _, _ = robot.plant().linearise(x, u)
    whole = np.zeros((10, 10))
    whole[:8, :8], whole[8:, :2] = a, np.eye(2)
    whole[:8] += b @ slope
    # gravity's slope is no part of a pair: take it out of the links' rows
    compliance = law.compliance.matrix(pose, law.plant.parameters.vector())
    whole[2:4, :2] = whole[2:4, :2] - (a[2:4, :2] + compliance @ np.diag(law.joints.stiffness))
    root = np.sqrt(law.joints.stiffness)
    pairs = []
    for square in np.linalg.eigvalsh(root[:, None] * compliance * root):
        own, drive, _ = law.gains.pair(square).matrices
        pairs.append(np.linalg.eigvals(own - drive @ law.gains(square)[None, :5]))
    found, wanted = np.linalg.eigvals(whole), np.concatenate(pairs)
    assert np.poly(found) == pytest.approx(np.poly(wanted), rel=1e-6)


@pytest.mark.costs("the law of one robot, traced with its inverse mass matrix")
def test_a_saved_law_of_position_drives_comes_back(tmp_path):
    """Unlike drives: the law has numbers that make their stiffness alike, and a file keeps them."""
    robot = driven_robot("planar-two-link", "position", (10.0, 25.0))
    law = ModalLaw.tuned(robot.problem(penalty=Penalty({"link_position": 1.0})), 1e-3, WEIGHTS)
    fh.Controller(law, None, period=1e-3, moving=True).save(tmp_path / "saved")
    stored = fh.load_controller(tmp_path / "saved").law
    x = np.random.default_rng(0).normal(0.0, 0.1, 10)
    assert np.array_equal(stored.evaluate_law(x, stored.law_data), law.evaluate_law(x, law.law_data))
    at = law.equilibrium[0]
    slope = np.array(
        [law.evaluate_about(1e-6 * d, at, law.equilibrium[1], law.law_data) for d in np.eye(10)]
    ).T
    assert slope / 1e-6 == pytest.approx(law.slope_at(at[:2]), rel=1e-6, abs=1e-6)
