import numpy as np
import pytest
from scipy.optimize import root

from flexhinf.errors import InvalidInput
from flexhinf.loop.simulation.metrics import (
    LimitCycle,
    StepShape,
    limit_cycle,
    load_metrics,
    step_metrics,
    step_shape,
    tail_of,
)

T = np.arange(0, 1001) * 0.01  # 10 s
NONE = {"overshoot_percent": None, "settling_time_s": None, "rise_time_s": None}


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
    assert step_metrics(T, constant(0.0), None) == NONE


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("start", "final", "at"), [(0.0, 1.0, 0.0), (1.0, -3.0, 0.0), (2.0, 3.5, 2.0), (0.0, -1.0, 2.0)]
)
def test_a_damped_oscillation(start, final, at):
    """1 − e^{−t} cos 5t: its largest value and its last crossing of the band are known."""
    since = np.maximum(T - at, 0.0)
    response = 1.0 - np.exp(-since) * np.cos(5.0 * since)
    found = step_metrics(T, start + (final - start) * response, StepShape(start, final, at))
    fine = np.linspace(0.0, 10.0 - at, 2_000_001)
    exact = -np.exp(-fine) * np.cos(5.0 * fine)
    assert found["overshoot_percent"] == pytest.approx(100.0 * exact.max(), abs=0.2)
    assert found["settling_time_s"] == pytest.approx(fine[np.abs(exact) > 0.02].max(), abs=0.011)


def test_overshoot_is_in_the_direction_of_the_step():
    undershooting = np.where(T < 1.0, -0.5, 1.0)
    assert step_metrics(T, undershooting, StepShape(0.0, 1.0, 0.0))["overshoot_percent"] == 0.0
    down = np.where(T < 1.0, -1.5, -1.0)
    assert step_metrics(T, down, StepShape(0.0, -1.0, 0.0))["overshoot_percent"] == pytest.approx(50.0)


def test_what_happens_before_the_command_does_not_count():
    position = np.where(T < 2.0, 7.0, 1.0)
    found = step_metrics(T, position, StepShape(0.0, 1.0, 2.0))
    assert (found["overshoot_percent"], found["settling_time_s"]) == (0.0, 0.0)


def test_never_settled_is_none():
    assert step_metrics(T, constant(0.97), StepShape(0.0, 1.0, 0.0))["settling_time_s"] is None
    late = np.where(T[-1] > T, 1.0, 1.03)
    assert step_metrics(T, late, StepShape(0.0, 1.0, 0.0))["settling_time_s"] is None
    early = np.where(T[-1] > T, 1.03, 1.0)
    assert step_metrics(T, early, StepShape(0.0, 1.0, 0.0))["settling_time_s"] == pytest.approx(9.99)


@pytest.mark.parametrize(("start", "final"), [(0.0, 1.0), (0.0, np.pi / 2), (1.0, -0.7), (0.0, 1e-6)])
def test_the_edges_of_the_band_are_inside(start, final):
    height = final - start
    for edge in (final + 0.02 * height, final - 0.02 * height):
        assert step_metrics(T, constant(edge), StepShape(start, final, 0.0))["settling_time_s"] == 0.0
    outside = constant(final + 0.0201 * height)
    assert step_metrics(T, outside, StepShape(start, final, 0.0))["settling_time_s"] is None


def test_a_step_of_no_height_has_no_figures():
    found = step_metrics(T, constant(1.0), StepShape(1.0, 1.0, 0.0))
    assert found == NONE


@pytest.mark.oracle
@pytest.mark.parametrize(("start", "final", "at"), [(0.0, 1.0, 0.0), (2.0, -1.0, 0.0), (1.0, 1.5, 2.0)])
def test_the_rise_of_a_lag_is_its_time_constant_times_ln_9(start, final, at):
    tau = 0.7
    position = start + (final - start) * (1.0 - np.exp(-np.maximum(T - at, 0.0) / tau))
    found = step_metrics(T, position, StepShape(start, final, at))
    assert found["rise_time_s"] == pytest.approx(tau * np.log(9.0), rel=1e-4)


def test_a_rise_counts_first_crossings_and_needs_90_percent():
    shape = StepShape(0.0, 1.0, 0.0)
    back = np.where(T < 1.0, 0.0, np.where(T < 2.0, 0.5, np.where(T < 3.0, 0.0, 1.0)))
    assert step_metrics(T, back, shape)["rise_time_s"] == pytest.approx(2.0, abs=0.011)
    assert step_metrics(T, constant(0.89), shape)["rise_time_s"] is None
    assert step_metrics(T, constant(1.0), shape)["rise_time_s"] == 0.0


def test_a_load_that_goes_again():
    position = 2.0 + np.where((T >= 4.0) & (T <= 6.0), -0.5, 0.0)
    found = load_metrics(T, position, command=2.0, step=2.0, start=4.0)
    assert found == {
        "peak_deviation": pytest.approx(0.5), "recovery_time_s": pytest.approx(2.0), "remaining_error": 0.0
    }  # fmt: skip
    small = 2.0 + np.where(T >= 4.0, 0.03, 0.0)
    assert load_metrics(T, small, command=2.0, step=-2.0, start=4.0) == {
        "peak_deviation": pytest.approx(0.03), "recovery_time_s": 0.0, "remaining_error": pytest.approx(0.03)
    }  # fmt: skip
    lasting = 2.0 + np.where(T >= 4.0, 0.3, 0.0)
    assert load_metrics(T, lasting, command=2.0, step=2.0, start=4.0)["recovery_time_s"] is None


@pytest.mark.oracle
@pytest.mark.parametrize("step", [1.0, -0.4, 0.05])
def test_recovery_of_an_exponential_is_its_logarithm(step):
    """A deviation 0.1 e^(−t/τ) leaves ±2 % of the step at τ ln(0.1 / 0.02 |step|), whatever its own peak is."""
    tau, start = 0.8, 3.0
    position = 0.7 - np.where(start <= T, 0.1 * np.exp(-(T - start) / tau), 0.0)
    found = load_metrics(T, position, command=0.7, step=step, start=start)
    assert found["peak_deviation"] == pytest.approx(0.1)
    assert found["recovery_time_s"] == pytest.approx(tau * np.log(0.1 / (0.02 * abs(step))), abs=0.011)


def test_a_load_needs_a_time_in_the_run_and_a_step():
    for bad in ({"step": 2.0, "start": 11.0}, {"step": 0.0, "start": 1.0}, {"step": np.nan, "start": 1.0}):
        with pytest.raises(InvalidInput):
            load_metrics(T, constant(2.0), command=2.0, **bad)


# Limit cycles -----------------------------------------------------------------------------------------
def relay_loop(duration, step=1e-4, delta=0.02, level=1.0):
    """x of x'' + x' = u with a relay with hysteresis: u = −level from x > delta on, until x < −delta."""
    times = np.arange(round(duration / step)) * step
    x, v, u, found = 0.5, 0.0, -level, []
    decay, moved = np.exp(-step), 1.0 - np.exp(-step)
    for _ in times:  # exact between samples
        found.append(x)
        u = -level if x > delta else level if x < -delta else u
        x, v = x + moved * v + (step - moved) * u, decay * v + moved * u
    return times, np.array(found)


@pytest.mark.oracle
def test_a_limit_cycle_against_its_describing_function_and_its_spectrum():
    """A relay with hysteresis δ: N(A) = 4M/(πA) exp(−j asin(δ/A)), and G(jω) N(A) = −1 [khalil2002]."""
    time, x = relay_loop(40.0)
    found = limit_cycle(time, x)
    assert found.frequency is not None

    def residual(unknown):
        amplitude, omega = np.exp(unknown)
        n = 4.0 / (np.pi * amplitude) * np.exp(-1j * np.arcsin(min(1.0, 0.02 / amplitude)))
        g = n / (1j * omega * (1j * omega + 1.0)) + 1.0
        return [g.real, g.imag]

    amplitude, omega = np.exp(root(residual, np.log([found.amplitude, 2.0 * np.pi * found.frequency])).x)
    assert found.amplitude == pytest.approx(
        amplitude, rel=0.08
    )  # the describing function leaves out harmonics
    assert 2.0 * np.pi * found.frequency == pytest.approx(omega, rel=0.08)
    tail = x[len(x) // 2 :] - x[len(x) // 2 :].mean()
    power = np.abs(np.fft.rfft(tail * np.hanning(len(tail)), 8 * len(tail)))
    peak = np.fft.rfftfreq(8 * len(tail), 1e-4)[int(np.argmax(power))]
    assert found.frequency == pytest.approx(peak, rel=0.01)


def test_a_limit_cycle_under_a_vibration_counts_slow_periods():
    time = np.arange(0.0, 120.0, 0.01)
    found = limit_cycle(time, 1.0 + np.sign(np.sin(2.0 * np.pi * time / 15.0)) + 0.2 * np.sin(30.0 * time))
    assert found.frequency == pytest.approx(1.0 / 15.0, rel=0.01)
    assert found.amplitude == pytest.approx(1.2, rel=0.01)


def test_what_rests_has_no_frequency_and_what_dies_out_no_amplitude():
    time = np.arange(0.0, 100.0, 0.01)
    assert limit_cycle(time, np.full(len(time), 0.3)) == LimitCycle(0.0, None)
    assert limit_cycle(time, np.exp(-time) * np.sin(9.0 * time)).amplitude < 1e-20
    assert limit_cycle(time, np.where(time > 80.0, 1.0, 0.0)) == LimitCycle(0.5, None)  # it still moves


@pytest.mark.parametrize(("samples", "part", "left"), [(101, 0.1, 11), (101, 0.5, 51), (4, 0.1, 1)])
def test_the_end_of_a_run_is_the_same_wherever_it_is_judged(samples: int, part: float, left: int) -> None:
    signal = np.arange(2.0 * samples).reshape(samples, 2)
    np.testing.assert_array_equal(tail_of(signal, part), signal[samples - left :])
