import numpy as np
import pytest

from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.plant import Plant, equilibrium
from flexhinf.plant.plant import pose_values
from flexhinf.robot import paper_arm


@pytest.mark.oracle
@pytest.mark.parametrize("angle", [-2.0, -0.3, 0.0, 0.5, np.pi / 2, 3.0, np.pi])
def test_the_arm_rests_where_spring_and_motor_hold_gravity(angle):
    x, u = equilibrium(paper_arm().plant(), ("link_position",), np.array([angle]))
    torque = 9.8 * np.sin(angle)
    np.testing.assert_allclose(x, [angle, 0.0, angle + torque / 100.0, 0.0], atol=1e-13)
    np.testing.assert_allclose(u, [torque * 10.0 / 9.0], atol=1e-12)


def test_the_coil_carries_the_holding_current():
    x, _ = equilibrium(paper_arm().plant(inductance=True), ("link_position",), np.array([1.0]))
    assert x[4] == pytest.approx(9.8 * np.sin(1.0) / 9.0, rel=1e-12)


def test_without_an_equilibrium_the_moving_state_is_named():
    plant = Plant(lambda x, u, d, p: np.array([1.0 + x[1] ** 2, u[0]]), lambda x, u, p: x, ("x", "v"), ("u",))
    with pytest.raises(NumericalFailure, match="d/dt x"):
        equilibrium(plant, (), np.zeros(0))


def test_a_model_that_is_not_finite_is_a_failure_too():
    plant = Plant(lambda x, u, d, p: np.log(x) + u, lambda x, u, p: x, ("x",), ("u",))
    with pytest.raises(NumericalFailure):
        equilibrium(plant, (), np.zeros(0))


def test_pose_by_name_and_in_order():
    np.testing.assert_array_equal(pose_values({"b": 2.0}, ("a", "b")), [0.0, 2.0])
    np.testing.assert_array_equal(pose_values([1.0, 2.0], ("a", "b")), [1.0, 2.0])
    np.testing.assert_array_equal(pose_values(3.0, ("a",)), [3.0])


@pytest.mark.parametrize(
    "pose", [{"c": 1.0}, {"a": np.nan}, {"a": "up"}, [1.0], [1.0, np.inf], "up", [[1.0, 2.0]]]
)
def test_poses_that_do_not_fit_are_refused(pose):
    with pytest.raises(InvalidInput):
        pose_values(pose, ("a", "b"))
