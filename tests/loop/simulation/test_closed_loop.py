import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.builders import runge_kutta
from tests.interpreter import interpret
from tests.refusals import refused_with

from flexhinf.codegen.noise import normal_numbers
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter
from flexhinf.loop import Controller, Loop, Quintic, Sine, Step
from flexhinf.loop.simulation.program import loop_program
from flexhinf.plant import Law, Plant
from flexhinf.robot import paper_arm

# Compiled in half the time: 1 s less.
pytestmark = pytest.mark.usefixtures("unoptimised")


# A closed loop in plain NumPy, from the equations of the paper --------------------------------------
def arm_flow(x, u, link, motor):
    """Sec. 6 with or without Table 2's coil, on plain floats."""
    q, dq, theta, dtheta = x[:4]
    torque = 9.0 * x[4] if len(x) == 5 else 0.9 * (u - dtheta)
    spring = 100.0 * (q - theta)
    rates = [dq, -9.8 * math.sin(q) - spring + link, dtheta, spring - 0.1 * dtheta + torque + motor]
    return rates + ([(u - 10.0 * x[4] - dtheta) / 0.1] if len(x) == 5 else [])


def arm_sub_step(x, u, torques, h):
    def at(k, share):
        return [a + share * h * b for a, b in zip(x, k)]

    k1 = arm_flow(x, u, *torques[0])
    k2 = arm_flow(at(k1, 0.5), u, *torques[1])
    k3 = arm_flow(at(k2, 0.5), u, *torques[1])
    k4 = arm_flow(at(k3, 1.0), u, *torques[2])
    return [a + h / 6 * (b + 2 * c + 2 * d + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4)]


def arm_columns(x, u):
    q, dq, theta, dtheta = x
    spring = 100.0 * (q - theta)
    return np.array([dq, -9.8 * np.sin(q) - spring, dtheta, spring - 0.1 * dtheta + 0.9 * (u - dtheta)])


def plain_loop(gain, reference, torque, noise, steps, parts, coil, saturation=np.inf, h=1e-3):
    """Algorithm 1 with np.linalg, trapezoidal integral, law, saturation, sub-steps of the true arm."""
    x, u = [0.0] * (5 if coil else 4), 0.0
    mean, covariance, process, measurement = np.zeros(4), 1e-4 * np.eye(4), 1e-8 * np.eye(4), 1e-6
    wc = np.array([2.0] + [1 / 8] * 8)
    integral, last, states, inputs, estimates = 0.0, None, [], [], []
    for k in range(steps):
        states.append(x)
        y = x[0] + noise[k]
        root = 2.0 * np.linalg.cholesky(covariance)
        points = np.column_stack([mean, mean[:, None] + root, mean[:, None] - root])
        expected = points[0, 1:].mean()
        e, s = points - mean[:, None], points[0] - expected
        gain_k, pyy = e @ (wc * s), (wc * s) @ s + measurement
        gain_k = gain_k / pyy
        mean = mean + gain_k * (y - expected)
        covariance = covariance - pyy * np.outer(gain_k, gain_k)
        growth = 0.0 if last is None else h * ((last[0] + y) / 2 - last[1])
        last = (y, reference(k * h))
        wanted = gain @ np.append(mean, integral + growth)
        u = min(max(wanted, -saturation), saturation)
        integral += growth - 0.2 * (wanted - u) / gain[4]
        inputs.append(u)
        estimates.append(mean)
        root = 2.0 * np.linalg.cholesky(covariance)
        points = np.column_stack([mean, mean[:, None] + root, mean[:, None] - root])
        points = runge_kutta(lambda points: arm_columns(points, u), points, h)  # noqa: B023
        mean = points[:, 1:].mean(axis=1)
        e = points - mean[:, None]
        covariance = (e * wc) @ e.T + process
        for j in range(parts):
            start, length = k * h + j * h / parts, h / parts
            x = arm_sub_step(x, u, [torque(start + s * length) for s in (0.0, 0.5, 1.0)], length)
    return np.array(states), np.array(inputs), np.array(estimates)


@pytest.mark.ci("10,000 steps in NumPy")
@pytest.mark.oracle
@pytest.mark.parametrize("coil", [False, True])
def test_the_compiled_loop_equals_a_plain_one_over_10_000_steps(made, coil):
    plant = paper_arm().plant(inductance=coil)
    loop = Loop(plant, Controller(made.law, made.ukf(), saturation=25.0, latency=0))
    disturbance = {"link_torque": Sine(2.0, 0.7), "motor_torque": Sine(1.0, 3.0, phase=1.0)}
    run = loop.run(Quintic(0.0, np.pi, 2.0), disturbance, noise=1e-3, duration=9.999, seed=7)
    states, inputs, estimates = plain_loop(
        made.law.gain[0], Quintic(0.0, np.pi, 2.0),
        lambda t: (2.0 * math.sin(1.4 * math.pi * t), math.sin(6.0 * math.pi * t + 1.0)),
        1e-3 * normal_numbers(7, np.arange(10_000), 0, 0), 10_000, loop.sub_steps, coil, 25.0,
    )  # fmt: skip
    assert len(run.time) == 10_000
    assert np.abs(states[:, 0]).max() > 3.0
    np.testing.assert_allclose(run.signals["state"], states, atol=1e-10)
    np.testing.assert_allclose(run.signals["input"][:, 0], inputs, atol=1e-10)
    np.testing.assert_allclose(run.signals["estimate"], estimates, atol=1e-10)


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("coil", [False, True])
@pytest.mark.parametrize(("period", "duration"), [(1e-3, 0.8), (1e-2, 4.0)])
def test_the_true_plant_equals_solve_ivp(made, coil, period, duration):
    """The inputs of a run, held between samples, and the torques as functions of time, through DOP853."""
    start = round(0.3 * duration / period) * period
    step, wave = Step(3.0, at=start), Sine(2.0, 1.3)
    loop = Loop(paper_arm().plant(inductance=coil), Controller(made.law, made.ukf(period), period, latency=0))
    run = loop.run(1.5, {"link_torque": step, "motor_torque": wave}, 1e-3, duration, [0.4, 0.0, 0.4, 0.0])
    x, worst = run.signals["state"][0], 0.0
    for k, u in enumerate(run.signals["input"][:-1, 0]):
        link = 3.0 if k >= round(start / period) else 0.0
        exact = solve_ivp(
            lambda t, s, u=u, link=link: arm_flow(s, u, link, 2.0 * math.sin(2.6 * math.pi * t)),
            (k * period, (k + 1) * period), x, "DOP853", rtol=1e-12, atol=1e-13,
        )  # fmt: skip
        x = exact.y[:, -1]
        worst = max(worst, np.abs(run.signals["state"][k + 1] - x).max())
    assert np.abs(run.signals["state"]).max() > 1.0
    assert worst < 1e-9


# The same in other ways -----------------------------------------------------------------------------
@pytest.mark.costs("compiles a loop and a step, as they ship")
@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["ukf", "redraw", "bounds", "ekf", None])
def test_the_controller_by_hand_equals_the_loop_exactly(made, kind, monkeypatch):
    monkeypatch.delenv("FLEXHINF_OPTIMISATION")
    settings = (paper_arm().plant(), 1e-3, 1e-8, 1e-6, np.zeros(4), 1e-4)
    estimator = {
        "ukf": lambda: made.ukf(), "ekf": lambda: ExtendedKalmanFilter(*settings), None: lambda: None,
        "redraw": lambda: UnscentedKalmanFilter(*settings, redraw=False),
        "bounds": lambda: UnscentedKalmanFilter(*settings, bounds={"link_velocity": (-1.0, 1.0)}),
    }[kind]()  # fmt: skip
    controller = Controller(made.law, estimator, saturation=14.0)
    run = Loop(paper_arm().plant(inductance=True), controller).run(
        Step(1.0, at=0.1), [1.0, 0.0], 1e-3, 0.6, seed=3
    )
    for y, r, u, estimate in zip(
        *(run.signals[name] for name in ("output", "reference", "input", "estimate"))
    ):
        np.testing.assert_array_equal(controller.step(y, r), u)
        np.testing.assert_array_equal(controller.estimate, estimate)


@pytest.mark.ci("compiles two loops")
@pytest.mark.oracle
@pytest.mark.parametrize("kind", [UnscentedKalmanFilter, ExtendedKalmanFilter])
def test_the_estimator_by_hand_equals_the_loop(made, kind):
    estimator = kind(paper_arm().plant(), 1e-3, 1e-8, 1e-6, np.zeros(4), 1e-4)
    run = Loop(paper_arm().plant(), Controller(made.law, estimator, latency=0)).run(
        1.0, noise=1e-3, duration=0.3
    )
    for y, u, estimate in zip(*(run.signals[name] for name in ("output", "input", "estimate"))):
        estimator.correct(y)
        np.testing.assert_allclose(estimator.mean, estimate, atol=1e-11)
        estimator.predict(u)


@pytest.mark.oracle
def test_compiled_equals_interpreted(made):
    loop = Loop(paper_arm().plant(inductance=True), Controller(made.law, made.ukf(), saturation=10.0))
    settings = {"reference": 1.0, "disturbance": {"link_torque": 0.5}, "noise": 1e-3, "duration": 0.1}
    compiled, prepared = loop.run(**settings), loop.prepared(**settings)
    interpreted = prepared.run(interpret(loop_program(prepared.code)))[0]
    for name, values in compiled.signals.items():
        np.testing.assert_allclose(values, interpreted.signals[name], atol=1e-12)


@pytest.mark.ci("compiles a loop of its own")
def test_the_same_seed_gives_the_same_bits(made):
    def run(seed):
        return Loop(paper_arm().plant(), Controller(made.law, made.ukf())).run(
            1.0, noise=1e-2, duration=0.2, seed=seed
        )

    for name, values in run(5).signals.items():
        np.testing.assert_array_equal(values, run(5).signals[name])
    assert np.any(run(5).signals["output"] != run(6).signals["output"])


@pytest.mark.ci("compiles two loops")
def test_a_run_like_the_last_one_is_the_same_as_in_a_new_loop(made):
    ukf = made.ukf()
    loop = Loop(paper_arm().plant(), Controller(made.law, ukf))
    arguments = ({"link_position": Step(0.5)}, {"link_torque": 0.1}, 1e-3, 0.2, [0.1, 0.0, 0.1, 0.0])
    changes = [{}, {"seed": 1}, {"seed": 1}, {"initial_input": [0.2]}, {"multi_turn": True}, {}]
    for change in changes:
        run, new = (one.run(*arguments, **change) for one in (loop, Loop(loop.true_plant, loop.controller)))
        assert run.settings == new.settings
        for name, values in new.signals.items():
            np.testing.assert_array_equal(run.signals[name], values)
    assert "_last" not in loop.__getstate__()
    ukf.initial = ukf.initial_at([0.05, 0.0, 0.05, 0.0])
    assert loop.run(*arguments).signals["estimate"][0, 0] != run.signals["estimate"][0, 0]


def test_a_function_of_time_is_asked_at_every_run(made):
    loop, slopes = Loop(paper_arm().plant(), Controller(made.law, None)), [0.1, 0.2]
    runs = [loop.run(lambda t, slope=slope: slope * t, duration=0.1) for slope in slopes]
    held = np.array([0.1])
    values = []
    for held[0] in slopes:
        values.append(loop.run(held, duration=0.1).signals["reference"][-1, 0])
    assert [run.signals["reference"][-1, 0] for run in runs] == pytest.approx([0.01, 0.02])
    assert values == slopes


def test_runs_do_not_touch_the_controller_or_each_other(made):
    controller = Controller(made.law, made.ukf())
    first = controller.step(0.3, 1.0)
    controller.reset()
    loop = Loop(paper_arm().plant(), controller)
    one = loop.run(1.0, duration=0.1)
    np.testing.assert_array_equal(controller.step(0.3, 1.0), first)
    two = loop.run(1.0, duration=0.1)
    np.testing.assert_array_equal(one.signals["input"], two.signals["input"])


def test_parameters_are_data(made):
    """Another plant's numbers take the same kernel, and change what happens as they should."""
    controller = Controller(made.law, None)
    soft, stiff = (Loop(paper_arm().plant().with_parameters(stiffness=k), controller) for k in (90.0, 110.0))
    assert soft.prepared().code.kernel() is stiff.prepared().code.kernel()
    ends = [loop.run(1.0, duration=0.3).signals["state"][-1] for loop in (soft, stiff)]
    assert np.abs(ends[0] - ends[1]).max() > 1e-4
    other = Loop(
        paper_arm().plant(),
        Controller(made.LinearLaw(made.law.state_names, made.law.input_names, 2 * made.law.gain), None),
    )
    assert other.prepared().code.kernel() is soft.prepared().code.kernel()
    assert np.abs(other.run(1.0, duration=0.3).signals["state"][-1] - ends[0]).max() > 1e-3


@pytest.mark.ci("a loop of its own, 20 s")
def test_several_inputs_and_a_state_that_is_not_tracked(made):
    plant, law = made.two_inputs()
    ukf = UnscentedKalmanFilter(plant, 1e-2, 1e-4, 1e-6, np.zeros(4), 1e-2)
    run = Loop(plant, Controller(law, ukf, 1e-2)).run(1.0, {"push": 0.5}, 1e-3, 20.0, {"b": 1.0})
    assert run.signals["state"][-1, 0] == pytest.approx(1.0, abs=0.01)
    assert run.signals["state"][-1, 2] == pytest.approx(0.0, abs=0.01)
    assert run.metrics()["settling_time_s"] < 15.0


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("kind", [UnscentedKalmanFilter, ExtendedKalmanFilter])
def test_a_model_without_parameters_disturbances_or_a_hash(made, kind):
    class Flow(list):
        def __call__(self, x, u, d, p):
            return np.array([x[1], u[0] - np.sin(x[0])])

    plant = Plant(Flow(), lambda x, u, p: x[0], ("x", "v"), ("u",))
    law = made.LinearLaw(("x", "v", "x_integral"), plant.inputs, [-6.0, -4.0, -3.0])
    estimator = kind(plant, 1e-2, 1e-6, 1e-6, np.zeros(2), 1e-4)
    controller = Controller(law, estimator, 1e-2)
    run = Loop(plant, controller).run(1.0, noise=1e-4, duration=20.0)
    assert run.signals["state"][-1, 0] == pytest.approx(1.0, abs=1e-3)
    assert run.signals["disturbance"].shape == (2001, 0)
    np.testing.assert_array_equal(controller.step(run.signals["output"][0], 1.0), run.signals["input"][0])


def test_about_a_pose_it_stays_there(made):
    law = made.law_about([1.0])
    ukf = made.ukf(mean=law.operating_point[:4])
    run = Loop(paper_arm().plant(), Controller(law, ukf)).run(duration=2.0)
    np.testing.assert_array_equal(run.signals["reference"], 1.0)
    np.testing.assert_allclose(run.signals["state"], np.tile(law.operating_point[:4], (2001, 1)), atol=1e-6)
    np.testing.assert_allclose(run.signals["input"], law.operating_input[0], atol=1e-5)
    exact = Loop(paper_arm().plant(), Controller(law, None)).run(duration=2.0)
    np.testing.assert_allclose(
        exact.signals["state"], np.tile(law.operating_point[:4], (2001, 1)), atol=1e-12
    )


def test_without_integrals_there_is_no_command(made):
    plant = Plant(lambda x, u, d, p: np.array([x[1], u[0]]), lambda x, u, p: x[0], ("x", "v"), ("u",))
    law = made.LinearLaw(plant.states, plant.inputs, [-2.0, -3.0])
    loop = Loop(plant, Controller(law, None, 1e-2))
    run = loop.run(duration=10.0, initial_state={"x": 1.0})
    assert abs(run.signals["state"][-1, 0]) < 1e-3
    assert run.signals["reference"].shape == (1001, 0)
    with pytest.raises(InvalidInput):
        loop.run(1.0)
    with pytest.raises(InvalidInput):
        loop.run(disturbance=1.0)
    with refused_with(InvalidInput, "tracked", "integrate="):
        run.metrics()


# Saturation -----------------------------------------------------------------------------------------
def test_saturation_holds_and_the_integral_follows_it(made):
    """A fifth of what an input lacks is taken back at every sample, so the law never asks for much more than there is;
    and where it asks for no more, nothing is taken."""
    controller = Controller(made.law, None, saturation=(-3.0, 11.0))
    run = Loop(paper_arm().plant(), controller).run(np.pi / 2, duration=6.0)
    u = run.signals["input"]
    assert u.min() >= -3.0
    assert u.max() == 11.0
    previous, last, limited, gain = 0.0, None, [], made.law.gain[0]
    for x, r, v in zip(run.signals["state"], run.signals["reference"], u[:, 0]):
        controller.step(x, r)
        growth = 0.0 if last is None else 1e-3 * (0.5 * (last + x[0]) - r[0])
        excess = gain @ np.append(x, previous + growth) - v
        expected = previous + growth - 0.2 * excess / gain[4]
        assert controller.integrals[0] == pytest.approx(expected, rel=1e-9, abs=1e-12)
        limited.append(abs(excess) if v in (-3.0, 11.0) else 0.0)
        previous, last = controller.integrals[0], x[0]
    assert np.count_nonzero(limited) > 100
    assert max(limited) < 0.1 * 11.0


@pytest.mark.ci("two loops of their own")
def test_anti_windup_takes_the_overshoot_of_windup_away(made):
    controller = Controller(made.law, made.ukf(), saturation=11.0)
    with_it = Loop(paper_arm().plant(), controller).run(np.pi / 2, duration=12.0)
    wound = Controller(made.law, made.ukf(), saturation=11.0)
    vector = wound.data_vector.copy()
    wound.data.named(vector).integral_relief[:] = 0.0  # then nothing is taken back
    wound.__dict__["data_vector"] = vector
    without = Loop(paper_arm().plant(), wound).run(np.pi / 2, duration=12.0)
    overshoots = [run.metrics()["overshoot_percent"] for run in (with_it, without)]
    assert overshoots[0] < 0.8 * overshoots[1]
    assert with_it.metrics()["settling_time_s"] is not None


# Failures -------------------------------------------------------------------------------------------
def test_divergence_is_told_with_the_time_and_the_run_so_far(made):
    law = made.LinearLaw(made.law.state_names, made.law.input_names, -40.0 * made.law.gain)
    run = Loop(paper_arm().plant(), Controller(law, None)).run(1.0, duration=60.0)
    assert run.status == "diverged"
    assert 0.0 < run.diverged_at == run.time[-1] < 60.0
    assert "plant" in run.message
    assert f"t = {run.time[-1]:g} s" in run.message
    assert np.all(np.isfinite(run.signals["state"]))
    metrics = run.metrics()
    assert set(metrics.values()) == {None}
    assert metrics.keys() == Loop(paper_arm().plant(), Controller(made.law, None)).run(1.0).metrics().keys()
    assert run.data.attrs["status"] == "diverged"


class RootLaw(Law):
    """A law that is not a number for negative positions."""

    law_key, state_names, input_names = "root", ("x",), ("u",)
    operating_point, operating_input, law_data = np.zeros(1), np.zeros(1), np.ones(1)

    def evaluate_law(self, x, data):
        return -data * np.sqrt(x)


@pytest.mark.parametrize("saturation", [None, 5.0])
def test_limits_do_not_hide_an_input_that_is_no_number(saturation):
    plant = Plant(lambda x, u, d, p: u - 1.0, lambda x, u, p: x, ("x",), ("u",))
    controller = Controller(RootLaw(), None, 0.1, saturation)
    run = Loop(plant, controller).run(duration=9.0, initial_state=[0.25])
    assert "controller" in run.message
    assert run.status == "diverged"
    assert len(run.time) < 5
    assert controller.step(0.25) == -0.5
    with refused_with(NumericalFailure, "estimate", "finite", "y=-0.25"):
        controller.step(-0.25)


@pytest.mark.parametrize(
    "settings",
    [
        {"duration": 0.0}, {"duration": -1.0}, {"duration": np.inf}, {"reference": "up"}, {"reference": [1.0, 2.0]},
        {"reference": np.nan}, {"reference": {"link": 1.0}}, {"disturbance": {"wind": 1.0}}, {"disturbance": 1.0},
        {"disturbance": lambda t: [t, np.nan]}, {"noise": -1.0}, {"noise": [1.0, 2.0]}, {"seed": -1}, {"seed": 0.5},
        {"initial_state": {"link": 1.0}}, {"initial_state": [1.0]},
    ],
)  # fmt: skip
def test_bad_runs_are_refused(made, settings):
    loop = Loop(paper_arm().plant(), Controller(made.law, made.ukf()))
    with pytest.raises(InvalidInput) as caught:
        loop.run(**{"duration": 0.01, **settings})
    assert caught.value.advice


def test_loops_that_do_not_fit_are_refused(made):
    controller = Controller(made.law, made.ukf())
    plant, law = made.two_inputs()
    for true_plant, word in (
        (paper_arm().plant(measured="motor_position"), r"\['link_position'\].*\['motor_position'\]"),
        (plant, r"\['link_position'\].*\['output_1', 'output_2'\]"),
        ("arm", "neither"),
    ):
        with pytest.raises(InvalidInput, match=word):
            Loop(true_plant, controller)
    with refused_with(InvalidInput, "Controller", "LinearLaw"):
        Loop(paper_arm().plant(), law)
    for count in (0, -1, 1.5, True, "4"):
        with pytest.raises(InvalidInput, match="sub-steps"):
            Loop(paper_arm().plant(), controller, sub_steps=count)
    with refused_with(InvalidInput, "plant", "'motor_velocity']", "['a', 'da', 'b', 'db']"):
        Loop(plant, Controller(made.law, None))
    swapped = made.LinearLaw(law.state_names, ("ub", "ua"), law.gain)
    with refused_with(InvalidInput, "inputs", "['ub', 'ua']", "['ua', 'ub']"):
        Loop(plant, Controller(swapped, None))


def test_sub_steps_come_from_the_fastest_mode_or_the_user(made):
    controller = Controller(made.law, None)
    assert Loop(paper_arm().plant(inductance=True), controller).sub_steps == 10
    coarse = Loop(paper_arm().plant(inductance=True), controller, sub_steps=2)
    assert coarse.sub_steps == 2
    run = coarse.run(1.0, duration=0.1)
    assert run.settings["sub_steps"] == 2
    fine = Loop(paper_arm().plant(inductance=True), controller).run(1.0, duration=0.1)
    assert 1e-13 < np.abs(run.signals["state"] - fine.signals["state"]).max() < 1e-4


def test_the_integral_removes_the_error_of_what_is_measured(made):
    """The estimator trusts a model that knows nothing of the torque: its bias must not become an offset."""
    ukf = made.ukf(process_noise=1e-9)
    loop = Loop(paper_arm().plant(), Controller(made.law, ukf))
    run = loop.run(Step(0.5), {"link_torque": Step(2.0, at=1.0)}, duration=25.0)
    position, estimate = run.signal("state", "link_position"), run.signal("estimate", "link_position")
    assert abs(estimate[-1] - position[-1]) > 1e-3
    assert abs(position[-1] - 0.5) < 1e-6


@pytest.mark.ci("a loop of its own, 25 s")
def test_where_the_tracked_state_is_not_measured_its_estimate_is_integrated(made):
    plant = paper_arm().plant(measured=("motor_position",))
    ukf = UnscentedKalmanFilter(plant, 1e-3, 1e-8, 1e-6, np.zeros(4), 1e-4)
    run = Loop(plant, Controller(made.law, ukf)).run(Step(0.5), duration=25.0)
    assert abs(run.signal("estimate", "link_position")[-1] - 0.5) < 1e-6
