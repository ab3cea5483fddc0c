"""The full nonlinear loop against the linear chain that it must be."""

import numpy as np
import pytest
from scipy.linalg import expm
from tests.baselines.conftest import NAMES, by_name, continuous
from tests.refusals import refused_with

from flexhinf.baselines import FeedbackLinearisation
from flexhinf.baselines.placed_laws import bessel_coefficients
from flexhinf.codegen.shared import share
from flexhinf.errors import InvalidInput
from flexhinf.loop import Controller, Loop
from flexhinf.plant import Plant
from flexhinf.robot.elastic import InverseFlow


def chain(coefficients):
    """Companion matrix of s^r + … + k_0."""
    r = len(coefficients)
    return np.vstack([np.eye(r)[1:], -np.asarray(coefficients)])


def sorted_modes(modes):
    """By real part, then by imaginary part, rounding aside."""
    return np.array(sorted(modes, key=lambda mode: (round(mode.real, 4), mode.imag)))


@pytest.mark.ci("five robots by SciPy to 1e-11")
@pytest.mark.oracle
@pytest.mark.parametrize("name", ["paper", "quanser", "rig", "planar-two-link", "spatial-three-link"])
def test_the_nonlinear_loop_is_a_linear_chain_in_every_joint(name):
    robot = by_name(name)
    plant, n = robot.plant(), len(robot.joint_names)
    law = FeedbackLinearisation.tuned(robot.problem(), 6.0)
    rng = np.random.default_rng(2)
    q = law.equilibrium[0][:n] + rng.uniform(-1.0, 1.0, n)
    lag = robot.operating_point(q)[0]
    start = lag + np.concatenate(
        [np.zeros(n), rng.normal(size=n), 0.05 * rng.normal(size=n), rng.normal(size=n)]
    )
    times, states = continuous(plant, law, start, 2.0)
    xi = law.form.coordinates(start, law.equilibrium[1], plant.parameters.vector())[0].reshape(n, 4).copy()
    xi[:, 0] -= law.equilibrium[0][:n]
    moved = np.array([expm(t * chain(law.coefficients[0])) for t in times])  # joints have equal poles
    expected = law.equilibrium[0][:n] + np.einsum("tij,nj->tin", moved, xi)[:, 0]
    np.testing.assert_allclose(states[:, :n], expected, atol=1e-6)
    assert np.abs(expected[0] - law.equilibrium[0][:n]).max() > 0.1


@pytest.mark.oracle
def test_with_integrals_a_torque_at_the_motor_leaves_no_error_as_the_chain_says():
    robot = by_name("planar-two-link")
    plant, law = robot.plant(), FeedbackLinearisation.tuned(robot.problem(), 6.0, integral=True)
    assert [len(each) for each in law.coefficients] == [5, 5]
    expected = np.tile(np.linalg.eigvals(chain(law.coefficients[0])), 2)
    np.testing.assert_allclose(
        sorted_modes(np.linalg.eigvals(law.closed_loop())), sorted_modes(expected), rtol=1e-5
    )
    push = np.array([0.0, 0.0, 0.2, -0.1])
    _, states = continuous(plant, law, law.equilibrium[0], 6.0, disturbance=push, rtol=1e-8)
    assert np.abs(states[:, :2] - law.equilibrium[0][:2]).max() > 1e-3
    np.testing.assert_allclose(states[-1, :2], law.equilibrium[0][:2], atol=1e-6)


@pytest.mark.ci("a motion of two links by SciPy to 1e-11")
@pytest.mark.oracle
def test_a_motion_of_the_elastic_inverse_dynamics_is_followed_and_errors_die_as_the_chain():
    robot = by_name("planar-two-link")
    plant, law = robot.plant(), FeedbackLinearisation.tuned(robot.problem(), 8.0)
    inverse, p = InverseFlow(robot.links, robot.drive), plant.parameters.named(plant.parameters.vector())
    size, rate = np.array([0.8, -0.6]), np.array([2.0, 3.0])

    def reference(t):
        phase = rate * t
        waves = (np.sin(phase), np.cos(phase), -np.sin(phase), -np.cos(phase), np.sin(phase))
        x, u = inverse(*(size * rate**k * wave for k, wave in enumerate(waves)), p)
        return np.asarray(x, dtype=float), np.asarray(u, dtype=float)

    start, _ = reference(0.0)
    offset = np.array([0.3, -0.2, 0, 0, 0.3, -0.2, 0, 0])
    times, states = continuous(plant, law, start + offset, 1.5, reference, np.linspace(0.0, 1.5, 31))
    vector = plant.parameters.vector()
    xi, xi_d = (
        law.form.coordinates(x, np.zeros(2), vector)[0].reshape(2, 4) for x in (start + offset, start)
    )
    errors = np.einsum("tij,nj->tin", [expm(t * chain(law.coefficients[0])) for t in times], xi - xi_d)[:, 0]
    wanted = np.array([reference(t)[0][:2] for t in times])
    np.testing.assert_allclose(states[:, :2], wanted + errors, atol=1e-6)


@pytest.mark.oracle
def test_a_damped_spring_has_degree_three_and_stable_zero_dynamics():
    robot = by_name("planar-two-link")
    problem = robot.problem(extras="joint_damping")
    law = FeedbackLinearisation.tuned(problem, 6.0)
    assert law.form.degrees == (3, 3)
    p = robot.plant_parameters()
    modes = np.linalg.eigvals(law.closed_loop())
    hidden = -p["stiffness"] / p["damping"]  # the twist relaxes by itself, D δ' + K δ = what the link needs
    expected = np.concatenate([np.tile(np.linalg.eigvals(chain(law.coefficients[0])), 2), hidden])
    np.testing.assert_allclose(sorted_modes(modes), sorted_modes(expected), rtol=1e-5)


@pytest.mark.ci("a law of seven links")
def test_seven_links_are_evaluated():
    robot = by_name("seven-link")
    law = FeedbackLinearisation.tuned(robot.problem(), 5.0)
    x, n = 0.02 * np.cos(np.arange(28.0)), 7
    k = law.evaluate_law(x, law.law_data)
    vector = law.plant.parameters.vector()
    xi = law.form.coordinates(law.equilibrium[0] + x, law.equilibrium[1], vector)[0].reshape(n, 4)
    error = -xi + np.pad(law.equilibrium[0][:n, None], ((0, 0), (0, 3)))
    v = error @ law.coefficients[0]
    flow = InverseFlow(robot.links, robot.drive)
    _, u = flow(*xi.T, v, law.plant.parameters.named(vector))
    np.testing.assert_allclose(law.equilibrium[1] + k, np.asarray(u, dtype=float), rtol=1e-6, atol=1e-6)


@pytest.mark.oracle
@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_the_poles_have_the_bandwidth_and_hardly_overshoot(order):
    from scipy.signal import freqs

    coefficients = bessel_coefficients(order, 7.0)
    _, at = freqs([coefficients[0]], [1.0, *coefficients[::-1]], [7.0])
    np.testing.assert_allclose(np.abs(at), np.sqrt(0.5), rtol=1e-6)
    start = np.zeros(order)
    start[0] = -1.0
    steps = [(expm(t * chain(coefficients)) @ start)[0] for t in np.linspace(0.0, 3.0, 300)]
    assert 0.0 < max(steps) < 0.01


@pytest.mark.oracle
def test_an_integral_of_its_own_rate_adds_one_pole_to_those_of_the_filter():
    problem = by_name("paper").problem()
    plain = FeedbackLinearisation.tuned(problem, 6.0).coefficients[0]
    slow = FeedbackLinearisation.tuned(problem, 6.0, integral=True, integral_rate=0.2).coefficients[0]
    expected = np.sort_complex([*np.roots([1.0, *plain[::-1]]), -1.2])
    np.testing.assert_allclose(np.sort_complex(np.roots([1.0, *slow[::-1]])), expected, rtol=1e-9)
    with refused_with(InvalidInput, "rate", "integral", 0.0):
        FeedbackLinearisation.tuned(problem, 6.0, integral=True, integral_rate=0.0)


@pytest.mark.ci("two loops of three links")
@pytest.mark.oracle
def test_the_sampled_loop_tends_to_the_chain_with_the_period():
    robot = by_name("spatial-three-link")
    law = FeedbackLinearisation.tuned(robot.problem(), 5.0)
    goal, held = robot.operating_point([0.3, 0.7, 0.8])
    errors = []
    for period in (5e-4, 2.5e-4):
        loop = Loop(robot.plant(), Controller(law, None, period, moving=True))
        run = loop.run(np.concatenate([goal, held]), duration=2.0)
        decay = np.array([expm(t * chain(law.coefficients[0]))[0, 0] for t in run.time])
        expected = goal[:3] + decay[:, None] * (law.equilibrium[0][:3] - goal[:3])
        errors.append(np.abs(run.signals["state"][:, :3] - expected).max())
    assert errors[0] < 1e-2
    np.testing.assert_allclose(errors[0] / errors[1], 2.0, rtol=0.1)  # the input is held: half a period late


def test_other_poles_compile_nothing(monkeypatch):
    robot = by_name("planar-two-link")
    problem = robot.problem()
    goal, held = robot.operating_point([0.3, 0.7])
    first = Controller(FeedbackLinearisation.tuned(problem, 5.0), None, moving=True)
    first.step(goal)

    def none(key, build):
        return share(key, lambda: pytest.fail("compiled again"))

    monkeypatch.setattr("flexhinf.loop.controller.controller.share", none)
    second = Controller(FeedbackLinearisation.tuned(problem, 4.0), None, moving=True)
    x, inputs = goal + 0.05, []
    for control in (first, second):
        law = control.law
        k = law.evaluate_about(x - goal, goal, held, law.law_data)
        inputs.append(control.step(x, np.concatenate([goal, held])))
        np.testing.assert_allclose(inputs[-1], held + k, rtol=1e-9, atol=1e-9)
    assert np.abs(inputs[0] - inputs[1]).max() > 1e-3


def test_robots_have_keys_of_their_own_and_numbers_do_not():
    laws = {
        name: FeedbackLinearisation.tuned(by_name(name).problem(), 5.0) for name in NAMES if name != "seven-link"
    }  # fmt: skip
    assert len({law.law_key for law in laws.values()}) == len(laws)
    heavier = by_name("paper").with_values({"mass": 1.3, "stiffness": 80.0})
    assert FeedbackLinearisation.tuned(heavier.problem(), 3.0).law_key == laws["paper"].law_key


def unstable_zero():
    """y = a has degree 1, and z' = z − … is not reached."""
    return Plant(
        lambda x, u, d, p: np.array([u[0] + x[1], x[1] - x[0]]), lambda x, u, p: x[:1], ("a", "z"), ("u",)
    )


@pytest.mark.parametrize(
    ("plant", "settings", "complaint"),
    [
        (unstable_zero(), {"coefficients": [[3.0]], "outputs": ("a",)}, r"unstable[\s\S]* 1 .*2 modes"),
        (None, {"coefficients": [[-1.0, 1.0, 1.0, 1.0]]}, r"unstable[\s\S]* 0 .*4 modes"),
        (None, {"coefficients": [[1.0, 1.0]]}, r"degrees[\s\S]*\[\(4,\)\], got \[\(2,\)\]"),
        (
            None,
            {"coefficients": [[1.0] * 4], "integrate": ("motor_position",)},
            r"outputs[\s\S]*\['motor_position'\]",
        ),
    ],
)
def test_what_does_not_fit_is_refused(plant, settings, complaint):
    plant = by_name("paper").plant() if plant is None else plant
    with pytest.raises(InvalidInput, match=complaint):
        FeedbackLinearisation(plant=plant, equilibrium=(np.zeros(plant.n), np.zeros(1)), **settings)


def test_a_singular_decoupling_matrix_is_refused():
    def flow(x, u, d, p):
        return np.array([u[0] + u[1], u[0] + u[1] * (1.0 + x[0])])

    plant = Plant(flow, lambda x, u, p: x[:1], ("a", "b"), ("u", "v"))
    with refused_with(InvalidInput, "A(x)", "singular"):
        FeedbackLinearisation(
            plant=plant,
            equilibrium=(np.zeros(2), np.zeros(2)),
            coefficients=[[1.0], [1.0]],
            outputs=("a", "b"),
        )


def test_a_bandwidth_is_needed():
    with pytest.raises(InvalidInput, match="bandwidth"):
        FeedbackLinearisation.tuned(by_name("paper").problem(), -1.0)
