"""What masses and payloads of a file do to the inverse inertia matrix, against inertia matrices of random robots."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.workspace import masses as benchmark
from benchmarks.workspace.robots import ROBOTS

import flexhinf as fh
from flexhinf.designs import Specification
from flexhinf.designs.responses import with_values
from flexhinf.designs.workspace import search
from flexhinf.designs.workspace.masses import POSES, largest_masses, stated_errors
from flexhinf.designs.workspace.proof import RANGE_POSES, RANGE_SEED, poses_outside
from flexhinf.designs.workspace.samples import POSES_SEED
from flexhinf.designs.workspace.search import RANDOM
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.modal.pair_errors import Sector
from flexhinf.plant.joints import link_compliance
from flexhinf.robot.workspace import workspace_of


@pytest.fixture(scope="module")
def setup():
    robot = ROBOTS["spatial"].robot()
    law, _ = benchmark.pairs_of(robot)
    return WorkspaceSetup(robot, Specification(), workspace_of(robot), law, RANDOM[0])


def carrying(payload):
    return replace(ROBOTS["spatial"], payload=payload).robot(payload=True)


def errors(setup, plants, poses):
    """Smallest and largest eigenvalue of Δ over plants and poses: those of M M̂⁻¹, less one."""
    model, own, ends = link_compliance(setup.law.plant), setup.law.plant.parameters.vector(), []
    for pose in poses:
        inertia = np.linalg.inv(model.matrix(pose, own))
        for plant in plants:
            true = link_compliance(plant).matrix(pose, plant.parameters.vector())
            ends.append(np.linalg.eigvals(inertia @ true).real)
    return np.min(ends) - 1.0, np.max(ends) - 1.0


@pytest.mark.costs("the law of a robot")
def test_masses_in_per_cent_hold_at_poses_that_nobody_looked_at(setup):
    """Of 5 % of every mass, all upwards or downwards, both ends are nearly reached; moments of inertia are exact."""
    stated, robot = stated_errors(setup), setup.true.robot
    assert (stated.poses, stated.errors.masses) == (0, pytest.approx((1.0 - 1.0 / 1.05, 1.0 / 0.95 - 1.0)))
    assert "stiffness" not in stated.others
    (share,) = {p.tolerance / 100.0 for p in robot.uncertain if p.name.startswith("stiffness")}
    assert stated.errors.springs == pytest.approx((share, share))
    rng = np.random.default_rng(5)
    masses = [p.name for p in robot.uncertain if p.name.startswith("mass")]
    corners = [
        robot.corner(dict(zip(masses, signs)))
        for signs in (*rng.uniform(-1.0, 1.0, (8, len(masses))), *np.outer([-1.0, 1.0], np.ones(len(masses))))
    ]
    plants = [with_values(setup.true_plant, values) for values in corners]
    low, high = errors(setup, plants, setup.workspace.sample(10, 99))
    assert -low <= stated.errors.masses.lower + 1e-9
    assert high <= stated.errors.masses.upper + 1e-9
    assert -low > 0.9 * stated.errors.masses.lower
    assert high > 0.9 * stated.errors.masses.upper


@pytest.mark.costs("the law of a robot")
def test_a_range_of_vibrations_is_judged_at_poses_that_did_not_choose_it(setup):
    """By eigenvalues of the joints' stiffness and inertia, which are those of a generalised problem."""
    low, high = setup.gains.ends
    assert RANGE_SEED != search.CHOSEN_SEED
    assert poses_outside(setup, low, high) == 0
    model, own = link_compliance(setup.law.plant), setup.law.plant.parameters.vector()
    stiffness = np.diag(setup.robot.plant_parameters()["stiffness"])
    squares = [
        np.linalg.eigvals(model.matrix(pose, own) @ stiffness).real
        for pose in setup.workspace.sample(RANGE_POSES, RANGE_SEED)
    ]
    least, most = np.quantile(np.min(squares, axis=1), 0.1), np.quantile(np.max(squares, axis=1), 0.8)
    outside = sum((each.min() < least) | (each.max() > most) for each in squares)
    assert 0.2 * RANGE_POSES <= outside == poses_outside(setup, least, most)


@pytest.mark.ci("the law of a robot, and many corners")
def test_no_corner_of_the_tolerances_is_worse_than_what_is_stated():
    """Of 300 random corners at poses that were looked at; some come near both ends."""
    robot = fh.load_robot("planar-two-link")
    law, _ = benchmark.pairs_of(robot)
    setup = WorkspaceSetup(robot, Specification(), workspace_of(robot), law, RANDOM[0])
    lower, upper = stated_errors(setup).errors.masses
    plants = [with_values(setup.true_plant, values) for values in robot.random_corners(300, 8)]
    low, high = errors(setup, plants, setup.workspace.sample(8, POSES_SEED))
    assert 0.95 * lower < -low <= lower + 1e-9
    assert 0.95 * upper < high <= upper + 1e-9


@pytest.mark.ci("two robots at many poses")
def test_the_largest_payload_is_that_which_reaches_the_end_of_the_sector(setup):
    """By eigenvalues of the robot that carries it, which a proportion of its masses takes as far."""
    sector = Sector(0.4, 0.5)
    largest = largest_masses(setup, sector, carrying("0..1kg"))
    assert largest.poses == POSES
    assert largest.tolerance == pytest.approx(1.0 / 3.0)
    for share, within in ((0.999, True), (1.01, False)):
        text = f"0..{share * largest.payload}kg"
        stated = stated_errors(replace(setup, other=carrying(text)))
        assert stated.poses == POSES
        assert (stated.errors.masses.lower <= sector.lower) == within
    none = largest_masses(setup, sector, setup.true.robot)
    assert np.isnan(none.payload)
    assert largest_masses(setup, Sector(0.0, 0.5), carrying("1kg")).payload == 0.0
