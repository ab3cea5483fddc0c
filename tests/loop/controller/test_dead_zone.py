"""The dead zone of a controller's integrals, against the same loop in plain NumPy."""

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.loop import Controller, load_controller

H, ZONE = 1e-2, 0.05


def integrals(made, controller, x, commands):
    found = []
    for r in commands:
        u = controller.step(x, r)
        found.append(controller.integrals[0])
        x = made.exact_step(x, u, 0.0)
    return np.array(found)


def plain(made, law, x, commands):
    """Only what of the error lies beyond the zone is integrated, by the trapezoidal rule."""
    found, integral, before = [], 0.0, None
    for r in commands:
        if before is not None:
            error = 0.5 * (before[0] + x[0]) - before[1]
            integral += H * np.sign(error) * max(0.0, abs(error) - ZONE)
        found.append(integral)
        u = law.gain @ np.append(x, integral)
        before, x = (x[0], r), made.exact_step(x, u, 0.0)
    return np.array(found)


@pytest.mark.oracle
def test_the_same_loop_in_plain_numpy(made):
    _, law = made.two_inputs()
    commands, start = [0.5] * 200 + [-0.2] * 200, np.array([0.2, 0.0, -0.3, 0.1])
    controller = Controller(law, None, H, integral_dead_zone=ZONE)
    found = integrals(made, controller, start, commands)
    np.testing.assert_allclose(found, plain(made, law, start, commands), rtol=1e-10, atol=1e-13)
    assert np.ptp(found) > 0.0
    without = integrals(made, Controller(law, None, H), start, commands)
    assert np.abs(found - without).max() > 0.01


def test_an_error_within_the_zone_stays(made):
    _, law = made.two_inputs()
    x = np.array([0.5 + 0.9 * ZONE, 0.0, 0.0, 0.0])
    controller = Controller(law, None, H, integral_dead_zone=[ZONE])
    for _ in range(5):
        controller.step(x, 0.5)
    assert controller.integrals == [0.0]


def test_it_is_saved_copied_and_named(made, tmp_path):
    _, law = made.two_inputs()
    controller = Controller(law, None, H, integral_dead_zone=ZONE)
    controller.save(tmp_path / "controller")
    for same in (load_controller(tmp_path / "controller"), controller.fresh()):
        assert same.integral_dead_zone == [ZONE]
        assert same.code_key[-1] == controller.code_key[-1]
    assert "± 0.05" in repr(controller)


def test_no_zone_is_the_code_without_one(made):
    _, law = made.two_inputs()
    assert Controller(law, None, H, integral_dead_zone=0.0).code_key == Controller(law, None, H).code_key


@pytest.mark.parametrize("zone", [-1e-3, [1e-3, 1e-3], np.nan, "wide"])
def test_a_zone_that_does_not_fit_is_refused(made, zone):
    with refused_with(InvalidInput, "zone", ">= 0", "['a']"):
        Controller(made.two_inputs()[1], None, H, integral_dead_zone=zone)
