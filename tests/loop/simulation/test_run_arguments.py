import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.loop import Controller
from flexhinf.loop.simulation.run_arguments import starting_state
from flexhinf.robot import paper_arm

WITH_COIL = paper_arm().plant(inductance=True).states


def test_by_name_in_order_and_by_default(made):
    controller = Controller(made.law_about([0.5]), None)
    lag = 9.8 * np.sin(0.5) / 100.0
    np.testing.assert_allclose(
        starting_state(None, WITH_COIL, controller), [0.5, 0, 0.5 + lag, 0, 0], atol=1e-12
    )
    named = {"coil_current": 2.0, "link_position": 0.1}
    np.testing.assert_array_equal(starting_state(named, WITH_COIL, controller), [0.1, 0, 0, 0, 2.0])
    np.testing.assert_array_equal(starting_state([1, 2, 3, 4, 5], WITH_COIL, controller), [1, 2, 3, 4, 5])
    np.testing.assert_array_equal(starting_state([1, 2, 3, 4], WITH_COIL, controller), [1, 2, 3, 4, 0])


def test_fewer_values_are_those_of_the_designed_plant_by_name(made):
    controller = Controller(made.law, None)
    mixed = ("coil_current", *reversed(controller.states))
    np.testing.assert_array_equal(starting_state([1, 2, 3, 4], mixed, controller), [0, 4, 3, 2, 1])


@pytest.mark.parametrize(
    "given",
    [
        {"speed": 1.0},
        {"link_position": np.nan},
        {"link_position": "up"},
        [1.0],
        [0] * 6,
        "rest",
        3.0,
        [np.inf] * 5,
    ],
)
def test_what_does_not_fit_is_refused(made, given):
    with pytest.raises(InvalidInput):
        starting_state(given, WITH_COIL, Controller(made.law, None))
