import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.loop.simulation.metrics import StepShape, disturbance_response, step_response, step_shape

T = np.arange(0, 1001) * 0.01  # 10 s


def constant(value):
    return np.full(len(T), float(value))


def test_a_command_from_the_start_steps_from_the_position():
    assert step_shape(T, constant(0.25), constant(2.0)) == StepShape(0.25, 2.0, 0.0)


def test_a_later_command_steps_from_the_command_before():
    reference = np.where(T >= 2.0, 5.0, 3.0)
    assert step_shape(T, constant(0.0), reference) == StepShape(3.0, 5.0, 2.0)


def test_a_quintic_is_a_step_and_a_sine_is_none():
    ramp = np.clip(T - 1.0, 0.0, 2.0)
    assert step_shape(T, constant(0.0), ramp) == StepShape(0.0, 2.0, pytest.approx(1.01))
    assert step_shape(T, constant(0.0), np.sin(T)) is None
    assert step_response(T, constant(0.0), None) == {"overshoot_percent": None, "settling_time_s": None}


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("start", "final", "at"), [(0.0, 1.0, 0.0), (1.0, -3.0, 0.0), (2.0, 3.5, 2.0), (0.0, -1.0, 2.0)]
)
def test_a_damped_oscillation(start, final, at):
    """1 − e^{−t} cos 5t: its largest value and its last crossing of the band are known."""
    since = np.maximum(T - at, 0.0)
    response = 1.0 - np.exp(-since) * np.cos(5.0 * since)
    found = step_response(T, start + (final - start) * response, StepShape(start, final, at))
    fine = np.linspace(0.0, 10.0 - at, 2_000_001)
    exact = -np.exp(-fine) * np.cos(5.0 * fine)
    assert found["overshoot_percent"] == pytest.approx(100.0 * exact.max(), abs=0.2)
    assert found["settling_time_s"] == pytest.approx(fine[np.abs(exact) > 0.02].max(), abs=0.011)


def test_overshoot_is_in_the_direction_of_the_step():
    undershooting = np.where(T < 1.0, -0.5, 1.0)
    assert step_response(T, undershooting, StepShape(0.0, 1.0, 0.0))["overshoot_percent"] == 0.0
    down = np.where(T < 1.0, -1.5, -1.0)
    assert step_response(T, down, StepShape(0.0, -1.0, 0.0))["overshoot_percent"] == pytest.approx(50.0)


def test_what_happens_before_the_command_does_not_count():
    position = np.where(T < 2.0, 7.0, 1.0)
    found = step_response(T, position, StepShape(0.0, 1.0, 2.0))
    assert found == {"overshoot_percent": 0.0, "settling_time_s": 0.0}


def test_never_settled_is_none():
    assert step_response(T, constant(0.97), StepShape(0.0, 1.0, 0.0))["settling_time_s"] is None
    late = np.where(T[-1] > T, 1.0, 1.03)
    assert step_response(T, late, StepShape(0.0, 1.0, 0.0))["settling_time_s"] is None
    early = np.where(T[-1] > T, 1.03, 1.0)
    assert step_response(T, early, StepShape(0.0, 1.0, 0.0))["settling_time_s"] == pytest.approx(9.99)


@pytest.mark.parametrize(("start", "final"), [(0.0, 1.0), (0.0, np.pi / 2), (1.0, -0.7), (0.0, 1e-6)])
def test_the_edges_of_the_band_are_inside(start, final):
    height = final - start
    for edge in (final + 0.02 * height, final - 0.02 * height):
        assert step_response(T, constant(edge), StepShape(start, final, 0.0))["settling_time_s"] == 0.0
    outside = constant(final + 0.0201 * height)
    assert step_response(T, outside, StepShape(start, final, 0.0))["settling_time_s"] is None


def test_a_step_of_no_height_has_no_figures():
    found = step_response(T, constant(1.0), StepShape(1.0, 1.0, 0.0))
    assert found == {"overshoot_percent": None, "settling_time_s": None}


def test_disturbance_figures():
    position = 2.0 + np.where((T >= 4.0) & (T <= 6.0), -0.5, 0.0)
    found = disturbance_response(T, position, command=2.0, height=2.0, at=4.0)
    assert found == {"peak_deviation": pytest.approx(0.5), "recovery_time_s": pytest.approx(2.0)}
    small = 2.0 + np.where(T >= 4.0, 0.03, 0.0)
    assert disturbance_response(T, small, 2.0, -2.0, 4.0) == {
        "peak_deviation": pytest.approx(0.03), "recovery_time_s": 0.0
    }  # fmt: skip
    lasting = 2.0 + np.where(T >= 4.0, 0.3, 0.0)
    assert disturbance_response(T, lasting, 2.0, 2.0, 4.0)["recovery_time_s"] is None
    with pytest.raises(InvalidInput, match="after the run"):
        disturbance_response(T, small, 2.0, 2.0, 11.0)
