"""Several laws behind one controller: which is active, and that the input does not jump."""

import pickle
from functools import partial

import numpy as np
import pytest
from tests.loop.conftest import moving_commands

from flexhinf.errors import InvalidInput
from flexhinf.estimation import UnscentedKalmanFilter
from flexhinf.hinf import smallest_gamma, solve_hji
from flexhinf.loop import Controller, Loop, Quintic, Schedule, Sine, load_controller
from flexhinf.loop.controller import controller, law_code
from flexhinf.loop.controller.step import controller_step
from flexhinf.plant import Law
from flexhinf.robot import load_robot, paper_arm

# Kernels that run once each: 2 s instead of 4 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

H = 1e-2
commands = partial(moving_commands, size=1.4)


@pytest.fixture(scope="module")
def linear(made):
    """Three laws of the double integrators about −1, 0.2 and 1, stiffer from one to the next."""
    _, law = made.two_inputs()
    poses, stiffer = (-1.0, 0.2, 1.0), (1.0, 1.5, 2.0)
    return [
        made.LinearLaw(
            law.state_names,
            law.input_names,
            factor * law.gain,
            [a, 0.0, 0.1 * a, 0.0, 0.0],
            [0.1 * a, 0.2 * a],
        )
        for a, factor in zip(poses, stiffer)
    ]


@pytest.fixture(scope="module")
def cubic():
    """The paper's arm about hanging, horizontal and upright."""
    problems = [paper_arm().problem(pose=[angle]) for angle in (0.0, np.pi / 2, np.pi)]
    return [solve_hji(p, gamma=3.0 * smallest_gamma(p), degree=4) for p in problems]


def followed(made_controller, run):
    """The active law of every sample: the controller again, step by step."""
    again, active = made_controller.fresh(), []
    for y, r, u in zip(*(run.signals[name] for name in ("output", "reference", "input"))):
        np.testing.assert_allclose(again.step(y, r), u, atol=1e-9)
        active.append(int(np.argmax(again.memory.named(again._history.memory).active)))
    return np.array(active)


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("start", ["zero", "bumpless"])
@pytest.mark.parametrize("limit", [None, 4.0])
def test_linear_laws_in_closed_form(made, linear, moving, start, limit):
    plant, _ = made.two_inputs()
    control = Controller(Schedule(linear, 0.2), None, H, limit, moving=moving, start=start, blend_time=0.4)
    t = np.arange(801) * H
    r = commands(t) if moving else commands(t)[:, :1]
    x = np.array([0.5, 0.0, 0.0, 0.2])
    reference = commands if moving else lambda time: commands(time)[0]
    run = Loop(plant, control).run(
        reference, {"push": 0.7}, duration=8.0, initial_state=x, initial_input=[0.3, -0.2]
    )
    states, inputs, active = made.plain_loop(
        linear, r, x, moving=moving, limit=limit or np.inf, bumpless=start == "bumpless", last=[0.3, -0.2],
        blend_time=0.4, hysteresis=0.2, push=0.7,
    )  # fmt: skip
    np.testing.assert_allclose(run.signals["state"], states, atol=1e-8)
    np.testing.assert_allclose(run.signals["input"], inputs, atol=1e-8)
    np.testing.assert_array_equal(followed_by_states(control, run), active)
    changes = np.flatnonzero(np.diff(active)) + 1
    assert set(active) == {0, 1, 2}
    np.testing.assert_allclose(inputs[changes], inputs[changes - 1], atol=1e-9)


def followed_by_states(control, run):
    again, active = control.fresh(), []
    again.reset(input=[0.3, -0.2])
    for x, r in zip(run.signals["state"], run.signals["reference"]):
        again.step(x, r)
        active.append(int(np.argmax(again.memory.named(again._history.memory).active)))
    return np.array(active)


@pytest.mark.ci("solves three laws, and steps through 10 s")
@pytest.mark.parametrize("moving", [False, True])
def test_the_input_of_the_arm_does_not_jump(made, cubic, moving):
    """Three cubic laws from hanging to upright and back, with filter, coil and noise."""
    control = Controller(Schedule(cubic), made.ukf(), moving=moving, latency=0)
    swing = Sine(np.pi / 2, 0.1, offset=np.pi / 2, phase=-np.pi / 2)
    goal = {"link_position": swing, "motor_position": swing} if moving else swing
    run = Loop(paper_arm().plant(inductance=True), control).run(goal, noise=1e-4, duration=10.0)
    active, u = followed(control, run), run.signals["input"][:, 0]
    changes = np.flatnonzero(np.diff(active)) + 1
    assert active[changes].tolist() == [1, 2, 1, 0]
    np.testing.assert_allclose(u[changes], u[changes - 1], atol=1e-9)
    positions = run.signals["reference"][changes, 0]
    quarter, share = (
        np.pi / 2,
        0.9,
    )  # nearer by 10 %: d_new = 0.9 d_old on the way up, and the same on the way down
    edges = quarter * np.array(
        [1 / (1 + share), 1 + 1 / (1 + share), 1 + share / (1 + share), share / (1 + share)]
    )
    np.testing.assert_allclose(positions, edges, atol=3e-3)
    assert np.abs(run.tracked("link_position") - run.signals["reference"][:, 0]).max() < 1.5


def test_between_two_poses_the_hysteresis_keeps_the_law(made, linear):
    wobble = Sine(0.02, 5.0, offset=0.6)  # around the middle of 0.2 and 1.0
    plant, counts = made.two_inputs()[0], []
    for hysteresis in (0.0, 0.3):
        control = Controller(Schedule(linear, hysteresis), None, H)
        run = Loop(plant, control).run(wobble, duration=2.0)
        active = np.array(
            [
                (control.step(x, r), int(np.argmax(control.memory.named(control._history.memory).active)))[1]
                for x, r in zip(run.signals["state"], run.signals["reference"])
            ]
        )
        counts.append(int(np.count_nonzero(np.diff(active))))
    assert counts[0] > 10
    assert counts[1] == 0


@pytest.mark.parametrize("way", ["made", "file", "pickle"])
@pytest.mark.parametrize("hysteresis", [None, 0.0, 0.05, 0.3, 0.6])
def test_another_law_takes_over_where_it_is_nearer_by_the_hysteresis(made, linear, hysteresis, way, tmp_path):
    """Between the laws about 0.2 and 1, up and down: at d_new = (1 − h) d_old and not a millionth of the way before."""
    control = Controller(Schedule(linear) if hysteresis is None else Schedule(linear, hysteresis), None, H)
    if way == "file":
        control.save(tmp_path / "controller")
        control = load_controller(tmp_path / "controller")
    elif way == "pickle":
        control = pickle.loads(pickle.dumps(control))
    share = 0.9 if hysteresis is None else 1.0 - hysteresis
    for old, new in ((0.2, 1.0), (1.0, 0.2)):
        edge = new + (old - new) * share / (1.0 + share)
        for offset, taken in ((1e-6, False), (-1e-6, True)):
            control.reset()
            control.step(np.zeros(4), old)
            control.step(np.zeros(4), edge + offset * (old - new))
            active = control.memory.named(control._history.memory).active
            assert control.laws[int(np.argmax(active))].operating_point[0] == (new if taken else old)


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("start", ["zero", "bumpless"])
@pytest.mark.parametrize("moving", [False, True])
def test_one_law_and_a_law_that_is_never_near_change_nothing(made, linear, start, moving):
    plant, _ = made.two_inputs()
    settings = {"moving": moving, "start": start}
    far = made.LinearLaw(linear[0].state_names, linear[0].input_names, linear[0].gain, [99, 0, 0, 0, 0])
    alone, one, two = (
        Loop(plant, Controller(law, None, H, **settings)).run(commands if moving else Quintic(-1.0, 0.5, 1.0))
        for law in (linear[0], Schedule([linear[0]]), Schedule([linear[0], far]))
    )
    for name in ("state", "input"):
        np.testing.assert_array_equal(one.signals[name], alone.signals[name])
        np.testing.assert_allclose(two.signals[name], alone.signals[name], atol=1e-11)


@pytest.mark.ci("compiles every controller twice")
@pytest.mark.oracle
@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("laws", ["linear", "cubic"])
@pytest.mark.parametrize("table", [0, 10**9])
def test_composed_equals_one_trace(made, linear, cubic, monkeypatch, moving, laws, table):
    plant, _ = made.two_inputs()
    ukf = UnscentedKalmanFilter(plant, H, 1e-4, 1e-6, np.zeros(4), 1e-2) if laws == "linear" else made.ukf(H)
    made_of = []
    for limit, columns in ((10**9, 10**9), (-1, table)):
        monkeypatch.setattr(controller, "ONE_TRACE", limit)
        monkeypatch.setattr(law_code, "TABLE", columns)
        schedule = Schedule(linear if laws == "linear" else cubic)
        made_of.append(Controller(schedule, ukf, H, 50.0, moving=moving, start="bumpless"))
        _ = made_of[-1].data_vector
    one, composed = made_of
    assert composed.composed
    assert not one.composed
    assert (composed.law_code.table is not None) == (laws == "cubic" and table == 0)
    rng, seen = np.random.default_rng(0), set()
    for k in range(40):
        y = np.full(len(one.measured), 0.05 * k) + 0.01 * rng.normal(size=len(one.measured))
        r = np.full(len(one.commanded), 0.08 * k)
        np.testing.assert_allclose(composed.step(y, r), one.step(y, r), rtol=1e-8, atol=1e-8)
        seen.add(int(np.argmax(composed.memory.named(composed._history.memory).active)))
    assert len(seen) > 1
    np.testing.assert_allclose(composed._history.memory, one._history.memory, rtol=1e-6, atol=1e-8)


@pytest.mark.ci("solves two laws of seven links")
@pytest.mark.oracle
def test_seven_links_at_two_poses(seven):
    """Composed, tables of monomials, a filter: equal to the text on floats, and without a jump."""
    solution, estimator, point, _ = seven
    robot = load_robot("seven-link")
    pose = point[:7] + 0.2
    other = solve_hji(robot.problem(pose=pose), gamma=700.0, degree=4)
    control = Controller(Schedule([solution, other]), estimator(), 2e-4, start="bumpless")
    assert control.composed
    assert control.law_code.table is not None
    memory, data, last = control.initial_memory(), control.data_vector, solution.operating_input
    for k, share in enumerate((0.0, 0.4, 0.6, 1.0)):
        y, r = point[:7] + 1e-3 * k, point[:7] + 0.2 * share
        named = control.memory.named(memory), control.data.named(data)
        parts = (control.law_code, control.estimator, control._sources)
        u, _, after = controller_step(*parts, y, r, *named, mode=control.mode)
        memory = control.memory.flat(after)
        np.testing.assert_allclose(control.step(y, r), u, rtol=1e-8, atol=1e-8 * np.abs(u).max())
        np.testing.assert_array_equal(control.memory.named(control._history.memory).active, [k < 2, k >= 2])
        if k in (0, 2):
            np.testing.assert_allclose(u, last, rtol=1e-11, atol=1e-9)
        last = u


def test_it_is_its_first_law_where_one_is_asked_for(linear, cubic):
    schedule = Schedule(linear[::-1])
    assert isinstance(schedule, Law)
    np.testing.assert_array_equal(schedule.operating_point, linear[2].operating_point)
    np.testing.assert_array_equal(schedule.operating_input, linear[2].operating_input)
    x = np.arange(5.0)
    np.testing.assert_array_equal(schedule.evaluate_law(x, schedule.law_data), linear[2].gain @ x)
    control = Controller(schedule, None, H)
    np.testing.assert_array_equal(control.operating_reference, [1.0])
    np.testing.assert_allclose(control.step(linear[2].operating_point[:4]), linear[2].operating_input)


def test_numbers_are_data(linear, cubic):
    one, two = Controller(Schedule(linear[:2], 0.1), None, H), Controller(Schedule(linear[1:], 0.5), None, H)
    three, plain = Controller(Schedule(linear), None, H), Controller(linear[0], None, H)
    assert one.code_key == two.code_key == one.fresh().code_key
    assert len({c.code_key for c in (one, three, plain)}) == 3
    assert not np.array_equal(one.data_vector, two.data_vector)


def test_misfits_are_refused(made, linear, cubic):
    problem = paper_arm().problem(pose=[0.5])
    quintic = solve_hji(problem, gamma=3.0 * smallest_gamma(problem), degree=6)
    names, inputs, gain = linear[0].state_names, linear[0].input_names, linear[0].gain

    def law(**changes):
        settings = {"states": names, "inputs": inputs, "gain": gain, "point": [0.5, 0, 0, 0, 0]}
        return made.LinearLaw(**{**settings, **changes})

    class Other(made.LinearLaw):
        pass

    cases = [
        (lambda: Schedule([]), r"schedule[\s\S]* \[\]"),
        (lambda: Schedule(linear[0]), r"schedule[\s\S]*sequence.*<LinearLaw"),
        (lambda: Schedule([linear[0], "law"]), r"flexhinf\.plant\.Law.* 'law'"),
        (lambda: Schedule([linear[0], law(gain=gain * np.nan)]), r"law.*finite"),
        (
            lambda: Schedule([linear[0], law(states=("a", "da", "c", "dc", "a_integral"))]),
            r"schedule[\s\S]*'c', 'dc'",
        ),
        (lambda: Schedule([linear[0], law(inputs=("uc", "ud"))]), r"schedule[\s\S]*\['uc', 'ud'\]"),
        (
            lambda: Schedule([linear[0], Other(names, inputs, gain, [0.5, 0, 0, 0, 0])]),
            r"formula[\s\S]* Other",
        ),
        (lambda: Schedule([cubic[0], quintic]), r"formula[\s\S]* 40 .* 251"),
        (
            lambda: Schedule([linear[0], linear[1], linear[0]]),
            r"poses[\s\S]*\[\[-1\.0\], \[0\.2\], \[-1\.0\]\]",
        ),
        (
            lambda: Schedule([law(states=names[:4], gain=gain[:, :4], point=[0, 0, 0, 0])]),
            r"poses[\s\S]*\[\[\]\]",
        ),
        (lambda: Schedule(linear, 1.0), r"hysteresis[\s\S]* 1\.0"),
        (lambda: Schedule(linear, -0.1), r"hysteresis[\s\S]* -0\.1"),
        (lambda: Schedule(linear, "some"), r"hysteresis[\s\S]*'some'"),
        (lambda: Controller(Schedule(linear), made.ukf()), r"estimator.*law[\s\S]*\['ua', 'ub'\]"),
    ]
    for make, word in cases:
        with pytest.raises(InvalidInput, match=word) as caught:
            make()
        assert caught.value.advice
    with pytest.raises(InvalidInput) as caught:
        Schedule([cubic[0], quintic])
    assert "degree" in caught.value.advice
