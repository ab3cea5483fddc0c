"""The observer in controllers and loops: compiled as written, kernels shared, beside the unscented filter."""

import numpy as np
import pytest
from tests.builders import linear_law

import flexhinf as fh
from flexhinf.estimation import OutputInjectionObserver
from flexhinf.loop.controller import controller as controller_module
from flexhinf.plant import Plant

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

PERIOD, R = 1e-3, np.deg2rad(0.1) ** 2
SLOW = [-12.0, -15.0, -9.0 + 6.0j, -9.0 - 6.0j]


@pytest.fixture(scope="module")
def cubic():
    problem = fh.paper_arm().problem()
    return fh.solve_hji(problem, gamma=2.0 * fh.smallest_gamma(problem), degree=4)


def observer(plant, **settings):
    noise = {"process_noise": 1e-6, "measurement_noise": R, "mean": np.zeros(plant.n), **settings}
    return OutputInjectionObserver(plant, PERIOD, **noise)


def rate_measured():
    """A two-link arm that has what the form needs: every position, and the links' velocities."""
    return fh.load_robot("planar-two-link").plant(["link_position", "link_velocity", "motor_position"])


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("one_trace", [10**9, 0], ids=["one trace", "composed"])
@pytest.mark.parametrize("make", [lambda: fh.paper_arm().plant(), rate_measured], ids=["arm", "two links"])
def test_compiled_it_is_the_shell(monkeypatch, make, one_trace):
    monkeypatch.setattr(controller_module, "ONE_TRACE", one_trace)
    plant, rng = make(), np.random.default_rng(0)
    m, p = len(plant.inputs), len(plant.outputs)

    law = linear_law(plant, rng.normal(size=(m, plant.n)))
    start = rng.normal(size=plant.n)
    controller = fh.Controller(law, observer(plant, mean=start), PERIOD, latency=0)
    assert controller.composed == (one_trace == 0)
    shell = observer(plant, mean=start)
    for _ in range(30):
        y = rng.normal(size=p)
        u = controller.step(y)
        shell.correct(y)
        np.testing.assert_allclose(controller.estimate, shell.mean, rtol=1e-10, atol=1e-10)
        shell.predict(u)
    belief = controller.memory.named(controller._history.memory).belief
    scale = np.sqrt(np.diag(shell.covariance))
    np.testing.assert_allclose(
        belief[1] / np.outer(scale, scale), shell.covariance / np.outer(scale, scale), atol=1e-9
    )


def test_observers_of_other_numbers_share_a_kernel_and_not_their_numbers(cubic):
    plant = fh.paper_arm().plant()
    stiff = plant.with_parameters(stiffness=130.0)
    made = [
        observer(plant),
        observer(plant, poles=SLOW),
        observer(stiff),
        observer(plant, process_noise=1e-2),
    ]
    controllers = [fh.Controller(cubic, filter, PERIOD, latency=0) for filter in made]
    assert len({controller.code_key for controller in controllers}) == 1
    for controller, filter in zip(controllers, made):
        for y in (0.1, 0.3, 0.2):
            u = controller.step(y, 0.5)
            filter.correct(y)
            np.testing.assert_allclose(controller.estimate, filter.mean, rtol=1e-11, atol=1e-12)
            filter.predict(u)
    assert len({round(float(controller.estimate[3]), 9) for controller in controllers}) == 4


@pytest.mark.ci("two loops")
@pytest.mark.oracle
def test_on_the_paper_s_arm_it_ties_with_the_unscented_filter(cubic):
    """A step to 180° with noise and the coil: the nonlinearity is measured, so the filters have little to differ in."""
    arm = fh.paper_arm()
    model, true = arm.plant(), arm.plant(inductance=True)
    rest = observer(model, about=np.array([np.pi, 0.0, np.pi, 0.0]))
    # From the same belief: the unscented filter takes 0.2 s to come to rest, which shows in six.
    filters = [fh.UnscentedKalmanFilter(model, PERIOD, 1e-6, R, np.zeros(4), rest.covariance), rest]
    runs = [
        fh.Loop(true, fh.Controller(cubic, filter, PERIOD)).run(
            reference=fh.Step(np.pi), duration=6.0, noise=np.sqrt(R), seed=2
        )
        for filter in filters
    ]
    rmse = np.array([run.metrics()["estimation_rmse"] for run in runs])
    np.testing.assert_allclose(rmse[1], rmse[0], rtol=1e-3)
    states = [run.data["state"].values for run in runs]
    assert np.abs(states[0] - states[1])[:, 0].max() < 1e-4
    for run in runs:
        assert abs(states[0][-1, 0] - np.pi) < 0.01
        assert run.metrics()["overshoot_percent"] < 5.0


@pytest.mark.oracle
def test_in_the_loop_the_error_is_a_power_of_a_matrix(cubic):
    """From 1.5 rad beside the motor's true position, while the arm swings up: known before the run."""
    plant = fh.paper_arm().plant()
    start = np.array([0.0, -2.0, 1.5, 3.0])
    filter = observer(plant, poles=SLOW, mean=start)
    run = fh.Loop(plant, fh.Controller(cubic, filter, PERIOD)).run(
        reference=fh.Step(np.pi), duration=3.0, initial_state=np.zeros(4)
    )
    errors = run.data["estimate"].values - run.data["state"].values[:, :4]
    assert np.abs(run.data["state"].values[:, 0]).max() > 2.5
    expected = (np.eye(4) - filter.gain @ np.eye(1, 4)) @ start
    for error in errors:
        np.testing.assert_allclose(error, expected, atol=2e-4)  # the hold of the gravity torque, T² of it
        expected = filter.error_matrix @ expected
    assert np.abs(errors[-1]).max() < 1e-5


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("name", ["quanser-rotflex", "vertical-rig"])
def test_robots_of_the_catalogue(name):
    robot = fh.load_robot(name)
    problem = robot.problem()
    law = fh.linear_law(problem, gamma=2.0 * fh.smallest_gamma(problem))
    plant = robot.plant()
    filter = observer(plant, mean=np.array([0.05, 0.0, 0.0, 0.0]), process_noise=[1e-10, 1e-6, 1e-10, 1e-6])
    run = fh.Loop(plant, fh.Controller(law, filter, PERIOD)).run(
        reference=fh.Step(0.3), duration=8.0, initial_state=np.zeros(4)
    )
    errors = run.data["estimate"].values - run.data["state"].values
    assert np.abs(errors[0]).max() > 1e-3
    assert np.abs(errors[-1]).max() < 1e-6
    assert run.data["state"].values[-1, 0] == pytest.approx(0.3, abs=5e-3)


def test_any_plant_with_the_form_two_outputs():
    """No robot: a Duffing oscillator that drives one of van der Pol, stabilised through the observer."""

    def flow(x, u, d, p):
        return np.array(
            [
                x[1],
                x[0] - x[0] ** 3 - 0.2 * x[1] + (1.0 + x[0] ** 2) * u[0],
                x[3]
                + p.mu * (x[2] - x[2] ** 3 / 3.0),  # in Liénard's coordinates, the damping is of x3 alone
                -x[2] + 0.5 * x[0],
            ]
        )

    plant = Plant(
        flow, lambda x, u, p: x[[0, 2]], ("a", "da", "b", "c"), ("u",), parameters={"mu": 1.5}, outputs=("a", "b")
    )  # fmt: skip
    filter = observer(plant, mean=np.array([1.0, -2.0, 0.5, 3.0]), poles=[-4.0, -5.0, -6.0, -7.0])

    law = linear_law(plant, [-3.0, -3.0, 0.0, 0.0])
    loop = fh.Loop(plant, fh.Controller(law, filter, PERIOD))
    run = loop.run(duration=12.0, initial_state=np.array([0.5, 0.0, 1.0, 0.0]))
    state, estimate = run.data["state"].values, run.data["estimate"].values
    assert np.abs(state[-1, :2]).max() < 1e-3  # held at the unstable rest
    assert np.abs(state[-2000:, 2]).max() > 1.5  # while the other one oscillates on
    assert np.abs(estimate[-1] - state[-1]).max() < 1e-5
