"""Plants with parameters, disturbances and offsets as states."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.estimation import UnscentedKalmanFilter


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["paper", "planar-two-link"])
def test_it_is_the_plant_with_other_numbers(name):
    """Against the plant with those parameters and disturbances themselves."""
    plant = fh.load_robot(name).plant(("link_position", "motor_position"))
    more = plant.augmented(("stiffness", "friction"), "link_torque", ("motor_position",))
    rng, k = np.random.default_rng(3), len(plant.inputs)
    assert len(more.states) == plant.n + 4 * k
    assert "stiffness" not in more.parameters.names
    x, u, d = rng.normal(size=plant.n), rng.normal(size=k), rng.normal(size=len(plant.disturbances))
    stiffness, friction = rng.uniform(50.0, 80.0, size=k), rng.uniform(0.1, 0.4, size=k)
    load, offset = rng.normal(size=k), 1e-3 * rng.normal(size=k)
    shape = plant.parameters.values["stiffness"].shape
    other = plant.with_parameters(stiffness=stiffness.reshape(shape), friction=friction.reshape(shape))
    acting = d.copy()
    acting[[plant.disturbances.index(one) for one in plant.expanded("link_torque")]] += load
    whole = np.concatenate([x, stiffness, friction, load, offset])
    rates = more.derivative(whole, u, d)
    np.testing.assert_allclose(rates[: plant.n], other.derivative(x, u, acting), rtol=1e-12)
    np.testing.assert_array_equal(rates[plant.n :], 0.0)
    y = more.output_at(whole, u)[0]
    expected = other.output_at(x, u)[0]
    expected[k:] += offset
    np.testing.assert_allclose(y, expected, rtol=1e-14)
    same = pickle.loads(pickle.dumps(more))
    np.testing.assert_array_equal(same.derivative(whole, u, d), rates)


def test_names_units_and_groups():
    plant = fh.load_robot("planar-two-link").plant(("motor_position",))
    more = plant.augmented(("stiffness",), "link_torque_elbow", "motor_position")
    assert more.states[8:] == (
        "stiffness_1", "stiffness_2", "link_torque_elbow", "motor_position_shoulder_offset",
        "motor_position_elbow_offset",
    )  # fmt: skip
    assert [more.unit(name) for name in more.states[8:]] == ["N·m/rad", "N·m/rad", "N·m", "rad", "rad"]
    assert more.expanded("stiffness") == ("stiffness_1", "stiffness_2")
    assert more.expanded("motor_position_offset") == more.states[-2:]
    assert more.disturbances == plant.disturbances


def test_a_map_stays_a_map():
    plant = fh.Plant(
        lambda x, u, d, p: p.decay * x + u + d, lambda x, u, p: x, ("level",), ("inflow",), ("leak",),
        {"decay": 0.9}, sampled=True,
    ).augmented(("decay",), ("leak",), ("output_1",))  # fmt: skip
    assert plant.sampled
    x = np.array([2.0, 0.8, -0.1, 0.3])
    np.testing.assert_allclose(plant.evaluate_flow(x, [0.5], [0.2], []), [2.2, 0.8, -0.1, 0.3])
    np.testing.assert_allclose(plant.output_at(x, np.zeros(1))[0], [2.3])


def test_what_acts_only_beyond_a_dead_zone_and_dry_friction_stay():
    robot = fh.load_robot("planar-two-link")
    plant = robot.plant(("motor_position",), extras=("coulomb_friction",))
    more = plant.augmented(("stiffness",))
    assert (plant.arrest is None) == (more.arrest is None)
    assert more.fastest_mode(
        np.concatenate([np.zeros(8), plant.parameters.values["stiffness"]])
    ) == pytest.approx(plant.fastest_mode(), rel=1e-9)


@pytest.mark.ci("compiles a filter with one state more")
def test_a_stiffness_is_found():
    """A spring of 5 % more than stated, from link and motor positions of a moving arm."""
    plant = fh.load_robot("paper").plant(("link_position", "motor_position"))
    true, more = plant.with_parameters(stiffness=105.0), plant.augmented(("stiffness",))
    estimator = UnscentedKalmanFilter(
        more, 5e-3, [1e-12, 1e-8, 1e-12, 1e-8, 1e-4], 1e-10, [0.0] * 4 + [100.0], [1e-10] * 4 + [100.0],
        form="square_root",
    )  # fmt: skip
    simulated = UnscentedKalmanFilter(
        true, 5e-3, 0.0, 1e-10, np.zeros(4), 0.0
    )  # its `transition` is the true arm
    x, p, rng = np.zeros(4), true.parameters.named(true.parameters.vector()), np.random.default_rng(0)
    for k in range(600):
        estimator.correct(x[[0, 2]] + 1e-5 * rng.normal(size=2))
        u = np.array([12.0 * np.sin(0.05 * k)])
        estimator.predict(u)
        x = np.asarray(simulated.transition(x, u, p), float)
    assert estimator.mean[4] == pytest.approx(105.0, rel=1e-3)
    assert abs(estimator.mean[4] - 105.0) < 4.0 * np.sqrt(estimator.covariance[4, 4])


@pytest.mark.parametrize(
    ("wanted", "anchors"),
    [
        ({}, ("parameters", "disturbances", "offsets")),
        ({"parameters": ("stifness",)}, ("stifness", "stiffness")),
        ({"disturbances": ("link_force",)}, ("link_force", "link_torque")),
        ({"offsets": ("link_velocity",)}, ("link_velocity", "motor_position")),
        ({"parameters": ("mass", "mass")}, ("mass",)),
    ],
)
def test_what_is_not_there_is_refused(wanted, anchors):
    plant = fh.load_robot("paper").plant(("motor_position",))
    with refused_with(InvalidInput, *anchors):
        plant.augmented(**wanted)
