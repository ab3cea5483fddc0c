"""Runs by the threads of a GPU, whose PTX this processor runs: the bits of runs in lanes."""

from __future__ import annotations

import numpy as np
import pytest
from tests.builders import forced_pendulum, linear_law
from tests.card import on_stand_in, stand_in  # noqa: F401 - fixtures
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.codegen import gpu, groups, shared
from flexhinf.codegen.program import Unsupported

pytestmark = pytest.mark.usefixtures("unoptimised", "on_stand_in")

PERIOD, COUNT, TORN, FAR = 0.01, 19, 2, (4, 11)
PLANT = forced_pendulum(("encoder", "gyro"))
SPRING = linear_law(PLANT, [-6.0, -3.0, -4.0], [0.3, 0.0], [4.0 * np.sin(0.3)], ("angle",))
SENSORS = (
    fh.Sensor("gyro", noise=1e-2, delay=2 * PERIOD),
    fh.Sensor("encoder", period=4 * PERIOD, delay=PERIOD, noise=1e-3, quantisation=2e-3),
)


@pytest.fixture(autouse=True)
def lanes(monkeypatch):
    """Also these few runs are worth the lanes."""
    monkeypatch.setenv("FLEXHINF_LANES_FROM", "0")


def looped(**options):
    estimator = fh.UnscentedKalmanFilter(
        PLANT, PERIOD, [1e-8, 1e-5], None, [0.3, 0.0], [1e-4, 1e-4], form="square_root", sensors=SENSORS
    )
    return fh.Loop(PLANT, fh.Controller(SPRING, estimator, PERIOD), 2, sensors=SENSORS, **options)


def assert_same_bits(ensemble, *arguments, **options):
    """Of all that is returned; of runs that diverge, not of what is counted until the others end."""
    cpu, card = (ensemble.run(*arguments, **options, device=device) for device in ("cpu", "gpu"))
    for state, values in cpu.by_state.items():
        for name, column in values.items():
            np.testing.assert_array_equal(card.by_state[state][name], column, name)
    for name, column in cpu.common.items():
        np.testing.assert_array_equal(card.common[name], column, name)
    for name in ("codes", "diverged_at", "kept"):
        np.testing.assert_array_equal(getattr(card, name), getattr(cpu, name), name)
    fine = cpu.completed
    np.testing.assert_array_equal(card.doubtful_samples[fine], cpu.doubtful_samples[fine])
    return cpu


@pytest.mark.ci("compiles an ensemble for lanes, and as PTX, which becomes C")
@pytest.mark.parametrize("threads", [1, groups.WARP])
def test_noise_missing_samples_far_angles_and_divergence_have_the_same_bits(
    threads,
    on_stand_in,  # noqa: F811
    monkeypatch,
):
    """Seven plants at a time, too, which is all that fits."""
    monkeypatch.setattr(groups, "LARGE", 0 if threads > 1 else groups.LARGE)
    monkeypatch.setattr(shared, "_kept", type(shared._kept)())
    names = ("state.angle", "output.encoder", "estimate.speed", "input.torque")
    ensemble = looped(delay=3 * PERIOD).ensemble(
        disturbance={"wind": fh.Step(0.2, at=0.1)}, duration=0.6, kept=names, instants=[0, 7, 30, 60]
    )
    states, inputs = np.tile([0.3, 0.0], (COUNT, 1)), np.linspace(-1.0, 1.0, COUNT)[:, None]
    states[FAR, 0], states[TORN] = (3e9, -1e200), (np.nextafter(np.inf, 0.0), 1e308)
    loads = np.linspace(0.5, 1.5, COUNT)[:, None]
    arguments = ([{}] * COUNT, range(COUNT), states, loads)
    found = assert_same_bits(ensemble, *arguments, initial_inputs=inputs)
    assert np.flatnonzero(found.codes).tolist() == [TORN]
    assert np.isfinite(found.kept[FAR, :, 0]).all()
    launched, waited = on_stand_in["launches"], on_stand_in["waits"]
    monkeypatch.setattr(gpu, "MOST_PLANTS", 7)
    assert_same_bits(ensemble, *arguments, initial_inputs=inputs)
    assert on_stand_in["launches"] == launched + 3
    assert (on_stand_in["waits"] > waited) == (threads > 1)


@pytest.mark.ci("compiles seven links for lanes, and as PTX, which becomes C")
def test_a_warp_makes_a_run_of_seven_links_with_the_same_bits(on_stand_in):  # noqa: F811
    """Noise, samples that are missing and late, and runs that diverge at once and later; both orders of threads."""
    robot = fh.load_robot("seven-link")
    plant, point = robot.plant(), robot.operating_point()[0]
    law = fh.solve_hji(robot.problem(), gamma=700.0, degree=4)
    sensors = tuple(
        fh.Sensor(name, period=1e-3 * (1 + k % 3), delay=1e-3 * (k % 2), noise=1e-5)
        for k, name in enumerate(plant.outputs)
    )
    ukf = fh.UnscentedKalmanFilter(plant, 1e-3, 1e-8, None, point, 1e-6, form="covariance", sensors=sensors)
    loop = fh.Loop(plant, fh.Controller(law, ukf, 1e-3, latency=0), 1, sensors=sensors)
    names = (*(f"estimate.{name}" for name in plant.states[::9]), f"input.{plant.inputs[2]}")
    ensemble = loop.ensemble(duration=0.006, kept=names, instants=[0, 1, 4, 6])
    truth = plant.parameters.vector() * (1.0 + 1e-3 * np.arange(8)[:, None])
    states = np.tile(ensemble.start["x"], (8, 1))
    states[1, 8], states[2, [0, 14]], states[3, [7, 21]] = 1e300, 2.0**31, 1e6
    for on_stand_in["backwards"] in (0, 1):
        waited = on_stand_in["waits"]
        found = assert_same_bits(ensemble, truth, range(8), states)
        assert found.codes.tolist() == [0, 2, 1, 1, 0, 0, 0, 0]
        assert len({*found.diverged_at[[1, 2, 3]].tolist()}) > 1
        assert on_stand_in["waits"] > waited


def test_a_model_that_calls_the_c_library_is_refused_by_the_functions_name():
    plant = fh.Plant(
        lambda x, u, d, p: np.array([x[1], u[0] - np.tanh(x[1])]),
        lambda x, u, p: x, ("q", "v"), ("u",), (), {"gain": 1.0},
    )  # fmt: skip
    law = linear_law(plant, [-1.0, -1.0])
    ensemble = fh.Loop(plant, fh.Controller(law, None, PERIOD), 1).ensemble(duration=0.1)
    with refused_with(Unsupported, "tanh", "cpu"):
        ensemble.run([{}] * COUNT, device="gpu")
