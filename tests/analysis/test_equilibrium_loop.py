"""The linearised loop against the whole step's Jacobian, SciPy's exponential, and runs of the nonlinear loop."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from tests.analysis.conftest import designed, filter_of, whole_jacobian
from tests.builders import linear_law
from tests.refusals import refused_with

from flexhinf.analysis import EquilibriumLoop
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.estimation import linear_model
from flexhinf.hinf import HJISolution
from flexhinf.loop import Constant, Controller, Loop
from flexhinf.robot import Robot, load_robot
from flexhinf.scalars import jacobian

PERIOD = 1e-3

# Twenty loops that are linearised once: 1.4 s instead of 2.3 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


def sorted_sizes(multipliers: np.ndarray) -> np.ndarray:
    return np.sort(np.abs(multipliers))[::-1]


@pytest.mark.quick_cases(3)
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("kind", "coil", "moving"),  # every two of them at every two of their values
    [(None, False, True), (None, True, False), ("ekf", False, False), ("ekf", True, True),
     ("observer", False, True), ("observer", True, False)],
)  # fmt: skip
def test_one_period_is_that_of_the_whole_step(
    arm: Robot, cubic: HJISolution, kind: str | None, coil: bool, moving: bool
) -> None:
    filter = None if kind is None else filter_of(arm.plant(), np.zeros(4), kind)
    plant, values = arm.plant(inductance=coil), arm.corner({"mass": 1.0, "stiffness": -1.0})
    loop = EquilibriumLoop(cubic, filter, plant, PERIOD, math.pi / 2, moving=moving, latency=0)
    found = loop.modes([values])
    later, slope = whole_jacobian(loop, found.equilibrium[0], values)
    assert np.allclose(later[: plant.n], found.equilibrium[0, : plant.n], atol=1e-9)
    expected = sorted_sizes(np.linalg.eigvals(slope))
    assert np.allclose(sorted_sizes(found.multipliers[0]), expected, atol=1e-9)


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("kind", [None, "ukf"])
def test_one_period_of_two_links(two_link: Robot, two_link_law: HJISolution, kind: str | None) -> None:
    x = two_link.operating_point()[0]
    filter = None if kind is None else filter_of(two_link.plant(), x, kind)
    loop = EquilibriumLoop(
        two_link_law,
        filter,
        two_link.plant(extras=("joint_damping",)),
        PERIOD,
        [0.6, 0.2],
        latency=0,
    )
    values = two_link.draw(np.random.default_rng(1))
    found = loop.modes([values])
    assert np.allclose(found.equilibrium[0, :2], [0.6, 0.2], atol=1e-9)
    _, slope = whole_jacobian(loop, found.equilibrium[0], values)
    assert np.allclose(sorted_sizes(found.multipliers[0]), sorted_sizes(np.linalg.eigvals(slope)), atol=1e-9)


def held(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exact discretisation with the input held."""
    n = len(a)
    both = expm(PERIOD * np.vstack([np.hstack([a, b]), np.zeros((b.shape[1], n + b.shape[1]))]))
    return both[:n, :n], both[:n, n:]


@pytest.mark.oracle
@pytest.mark.parametrize("coil", [False, True])
@pytest.mark.parametrize("goal", [math.pi / 2, math.pi])
def test_modes_are_those_of_the_loop_assembled_by_hand(
    arm: Robot, cubic: HJISolution, goal: float, coil: bool
) -> None:
    """correct → integral of the measured error → law → time update, written out for the linear parts."""
    filter = filter_of(arm.plant(), np.zeros(4))
    loop = EquilibriumLoop(cubic, filter, arm.plant(inductance=coil), PERIOD, goal, latency=0)
    found = loop.modes([arm.nominal])
    n, rest = loop.plant.n, found.equilibrium[0]
    phi, gamma = held(*loop.plant.linearise(rest[:n], loop.model_equilibrium[1])[:2])
    f, g = held(*filter.plant.linearise(*loop.model_equilibrium)[:2])
    h = np.array([[1.0, 0.0, 0.0, 0.0]])
    gain = loop.gain(filter.process_noise)
    integral = rest[n:][loop.step.places["integral"]]
    k = jacobian(cubic.evaluate_law, 5, cubic.law_data.size)(
        np.concatenate([loop.model_equilibrium[0], integral]), cubic.law_data
    )[1]
    # State of the sampled loop: true x, predicted estimate, integral before, measured position before.
    measured, error = np.eye(1, n + 6), np.zeros((1, n + 6))
    estimate = np.hstack([gain @ np.eye(1, n), np.eye(4) - gain @ h, np.zeros((4, 2))])
    error[0, n + 4], error[0, n + 5] = 1.0, 0.5 * PERIOD
    error += 0.5 * PERIOD * measured
    u = k[:, :4] @ estimate + k[:, 4:] @ error
    true = np.hstack([phi, np.zeros((n, 6))]) + gamma @ u
    assembled = np.vstack([true, f @ estimate + g @ u, error, measured])
    expected = sorted_sizes(np.linalg.eigvals(assembled))
    assert np.allclose(sorted_sizes(found.multipliers[0])[:8], expected[:8], atol=1e-10)


def grown(run: Any, name: str) -> float:
    """Growth rate of a signal from the middle to the end of a run, 1/s."""
    signal, time = run.signal("state", name), run.time
    first, last = (
        np.sqrt(np.mean(signal[(time >= a * time[-1]) & (time <= b * time[-1])] ** 2))
        for a, b in ((0.4, 0.6), (0.8, 1.0))
    )
    return float(np.log(last / first) / (0.4 * time[-1]))


@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["ukf", None])
def test_rate_is_that_of_a_long_run(arm: Robot, cubic: HJISolution, kind: str | None) -> None:
    names = ("mass", "length", "link_inertia", "motor_inertia", "friction", "resistance")
    values = arm.corner(
        dict.fromkeys(names, -1.0) | {"stiffness": 1.0, "torque_constant": 1.0, "back_emf_constant": -1.0}
    )
    filter = None if kind is None else filter_of(arm.plant(), np.zeros(4), kind, noise=(1e-6, 1e-6))
    plant = arm.plant(inductance=True)
    expected = EquilibriumLoop(cubic, filter, plant, PERIOD, math.pi).modes([values]).rate[0]
    controller = Controller(cubic, filter, PERIOD)
    run = Loop(plant.with_parameters(**values), controller).run(Constant(math.pi), duration=30.0)
    assert grown(run, "link_velocity") == pytest.approx(expected, abs=5e-3)
    assert (expected > 0.0) == (kind == "ukf")  # the corner that only the estimated loop does not withstand


def test_a_law_without_integrals_rests_off_the_goal(two_link: Robot) -> None:
    """PD on the motors about a pose, with gravity wrong: f(x, u) = 0 and u = u* − K (x − x*), by a long run."""
    plant = two_link.plant()
    x, u = two_link.operating_point([0.5, 0.3])
    gains = np.hstack([np.zeros((2, 4)), np.diag([60.0, 30.0]), np.diag([6.0, 3.0])])
    law, values = linear_law(plant, -gains, x, u), two_link.corner({"mass_elbow": 1.0, "mass_shoulder": 1.0})
    loop = EquilibriumLoop(law, None, plant, PERIOD)
    found = loop.modes([values, {}])
    rest = found.equilibrium[:, :8]
    assert np.abs(rest[0, :2] - x[:2]).max() > 1e-4
    assert np.allclose(rest[1], x, atol=1e-9)
    assert np.allclose(found.equilibrium[0, 8:], u - gains @ (rest[0] - x), atol=1e-9)
    assert np.abs(plant.with_parameters(**values).derivative(rest[0], found.equilibrium[0, 8:])).max() < 1e-8
    run = Loop(plant.with_parameters(**values), Controller(law, None, PERIOD)).run(duration=8.0)
    assert np.allclose(run.signals["state"][-1], rest[0], atol=1e-5)


def test_a_moving_reference_holds_any_goal(two_link: Robot, two_link_law: HJISolution) -> None:
    """About a pose far from the operating point the law acts as it does there, and nothing is left to integrate."""
    rest = two_link.operating_point([1.2, -0.4])
    filter = filter_of(two_link.plant(), rest[0])
    loop = EquilibriumLoop(
        two_link_law, filter, two_link.plant(), PERIOD, equilibrium=rest, moving=True, latency=0
    )
    found = loop.modes([{}, two_link.corner({"stiffness_elbow": -1.0})])
    assert found.stable.all()
    assert np.allclose(found.equilibrium[0, :8], rest[0], atol=1e-9)
    integrals = found.equilibrium[:, 8:][:, loop.step.places["integral"]]
    assert np.allclose(integrals[0], 0.0, atol=1e-9)
    _, slope = whole_jacobian(loop, found.equilibrium[0])
    assert np.allclose(sorted_sizes(found.multipliers[0]), sorted_sizes(np.linalg.eigvals(slope)), atol=1e-9)


def test_no_rest_is_infinite_and_spoils_no_other(arm: Robot, cubic: HJISolution) -> None:
    """An estimator that ignores the measurement drifts off a plant that differs from its model."""
    loop = EquilibriumLoop(
        cubic, filter_of(arm.plant(), np.zeros(4), noise=(0.0, 1e-8)), arm.plant(), PERIOD, math.pi / 2
    )
    modes = loop.modes([arm.corner({"mass": 1.0})])
    assert math.isinf(modes.rate[0])
    assert not modes.stable[0]
    assert np.isnan(modes.equilibrium).all()
    with refused_with(NumericalFailure, "equilibrium", "[1.570796]"):
        loop.linear(arm.corner({"mass": 1.0}))


def test_a_search_that_strays_far_says_nothing_and_spoils_no_other(two_link: Robot) -> None:
    """Inputs that are late are linearised after the search: only where it found a rest."""
    plant = two_link.plant()
    x, u = two_link.operating_point([0.5, 0.3])
    gains = np.hstack([np.zeros((2, 4)), np.diag([60.0, 30.0]), np.diag([6.0, 3.0])])
    loop = EquilibriumLoop(linear_law(plant, -gains, x, u), None, plant, PERIOD, delay=1)
    far = np.zeros(len(loop.start))
    far[[plant.index(name) for name in plant.states if name.startswith("link_velocity")]] = 1e70
    modes = loop.modes([{}, {}], near=np.array([np.full(len(far), np.nan), far]))
    assert modes.rate[0] == loop.modes([{}]).rate[0]
    assert math.isfinite(modes.rate[0])
    assert math.isinf(modes.rate[1])
    assert np.isnan(modes.equilibrium[1]).all()


def test_plants_do_not_mix(arm: Robot, cubic: HJISolution) -> None:
    plant, rng = arm.plant(inductance=True), np.random.default_rng(3)
    loop = EquilibriumLoop(cubic, filter_of(arm.plant(), np.zeros(4)), plant, PERIOD, math.pi)
    values = [arm.draw(rng) for _ in range(5)]
    together = loop.modes(values).rate
    assert np.allclose(together, [loop.modes([v]).rate[0] for v in values], rtol=1e-9)
    assert len(set(np.round(together, 6))) == 5


@pytest.mark.oracle
def test_the_model_is_that_of_the_filter(two_link: Robot, two_link_law: HJISolution) -> None:
    x, u = two_link.operating_point()
    filter = filter_of(two_link.plant(), x)
    loop = EquilibriumLoop(two_link_law, filter, two_link.plant(), PERIOD)
    for found, expected in zip(loop.model, linear_model(filter, x, u), strict=True):
        assert np.allclose(found, expected, rtol=1e-10, atol=1e-12)


@pytest.mark.ci("a law and a loop of seven links")
def test_seven_links_with_their_estimator() -> None:
    robot = load_robot("seven-link")
    law, x = designed(robot, degree=2, ratio=3.0), robot.operating_point()[0]
    plant, rng = robot.plant(), np.random.default_rng(0)
    loop = EquilibriumLoop(law, filter_of(plant, x), plant, PERIOD)
    modes = loop.modes([{}, *(robot.draw(rng) for _ in range(3))])
    assert modes.stable.all()
    assert np.allclose(modes.equilibrium[:, :7], x[:7], atol=1e-9)
    # The slowest pole of each joint is that of the nominal continuous design, to the sampling.
    a, b, _, _ = plant.linearise(*loop.model_equilibrium)
    gains = jacobian(law.evaluate_law, 35, law.law_data.size)(np.zeros(35), law.law_data)[1]
    whole = np.block([[a + b @ gains[:, :28], b @ gains[:, 28:]], [np.eye(7, 28), np.zeros((7, 7))]])
    assert modes.rate[0] == pytest.approx(np.linalg.eigvals(whole).real.max(), rel=1e-2)


def test_misuse_is_refused(arm: Robot, cubic: HJISolution) -> None:
    plant = arm.plant()
    with pytest.raises(InvalidInput, match="twice"):
        EquilibriumLoop(cubic, None, plant, PERIOD, 0.1, equilibrium=(np.zeros(4), np.zeros(1)))
    with refused_with(InvalidInput, "delay", 0.5):
        EquilibriumLoop(cubic, None, plant, PERIOD, delay=0.5)  # type: ignore[arg-type]
    with refused_with(InvalidInput, "integrals", "goal=0.5"):
        EquilibriumLoop(linear_law(plant, np.ones(4)), None, plant, PERIOD, 0.5)
    with refused_with(InvalidInput, "filter", "NoneType"):
        EquilibriumLoop(cubic, None, plant, PERIOD).gain(np.eye(4))
    with pytest.raises(InvalidInput, match="stiffness_"):
        EquilibriumLoop(cubic, None, plant, PERIOD).modes([{"stiffness_": 1.0}])
