"""What a log tells of a model: true values inside intervals, what it cannot tell, the file that it writes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from tests.identification.test_likelihood import plain_likelihood, sought
from tests.logs import PERIOD, TRUE, arm_log, linear_log, oscillator, recorded, share
from tests.refusals import refused_with, unnamed
from tests.robot.test_coupling import belt
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.identification.identify import searched
from flexhinf.identification.information import Information
from flexhinf.identification.unknowns import Unknowns, robot_numbers
from flexhinf.robot import Parameter

WRONG = {"stiffness": 55.0, "damping": 0.3, "gain": 1.0}


@pytest.fixture(scope="module")
def arm():
    robot = fh.load_robot("paper")
    wrong = robot.with_values({"stiffness": 70.0, "friction": 0.2, "motor_inertia": 1.3})
    return robot, wrong, arm_log(robot, count=2000)


@pytest.fixture(scope="module")
def found(arm):
    """Numbers from wrong ones."""
    _, wrong, log = arm
    names = ("stiffness", "friction", "motor_inertia", "link_inertia")
    return fh.identify(wrong, log, names, measured=("link_position", "motor_position"))


@pytest.fixture(scope="module")
def partly_found(arm):
    """Numbers of which two act as one."""
    _, wrong, log = arm
    names = ("mass", "length", "stiffness")
    return fh.identify(wrong, log, names, measured=("link_position", "motor_position"))


@pytest.mark.ci("a search without gradients over a plain filter")
@pytest.mark.oracle
def test_the_estimates_are_those_of_another_optimiser():
    log = linear_log(3)
    found = fh.identify(oscillator(**WRONG), log, tuple(WRONG))
    peer = minimize(
        lambda z: -plain_likelihood(log, *np.exp(z)), np.log([*TRUE.values(), 0.01, 0.1]), method="Nelder-Mead",
        options={"xatol": 1e-7, "fatol": 1e-9, "maxiter": 4000, "maxfev": 4000},
    )  # fmt: skip
    np.testing.assert_allclose(list(found.values.values()), np.exp(peer.x[:3]), rtol=2e-3)
    likelihood, unknowns = sought(log, plant=oscillator(**WRONG))
    most, evaluation, _ = searched(likelihood, unknowns, unknowns.start)
    np.testing.assert_allclose(np.exp(most), np.exp(peer.x), rtol=2e-3)
    assert evaluation.value == pytest.approx(-peer.fun, abs=1e-3)


@pytest.mark.ci("identifies 12 logs")
def test_noise_levels_are_those_of_the_truth_though_numbers_are_sought_beside():
    levels = [
        fh.identify(oscillator(), linear_log(40 + k, count=400), tuple(WRONG)).noise["load"]
        for k in range(12)
    ]
    assert np.mean(levels) == pytest.approx(0.1, rel=0.1)


@pytest.mark.ci("simulates two seconds of the arm, and finds four numbers")
def test_an_arm_s_numbers_are_found_from_wrong_ones(arm, found):
    robot, _, log = arm
    assert not found.unidentifiable
    for name in found.names:
        low, high = found.intervals[name]
        middle = robot.nominal[name]
        assert low - (high - low) < middle < high + (high - low)
        assert found.standard_errors[name] < 1e-3 * middle
    assert found.noise["link_position"] == pytest.approx(1e-4, rel=0.1)
    positions, torques = ("link_position", "motor_position"), ("link_torque", "motor_torque")
    assert found.noise_units == dict.fromkeys(positions, "rad") | dict.fromkeys(torques, "N·m·√s")
    assert found.correlations.shape == (4, 4)
    np.testing.assert_allclose(np.diag(found.correlations), 1.0)
    better = fh.filter_log(found.filter(1e-3), log)
    assert float(better.nis.mean()) == pytest.approx(2.0, rel=0.15)


@pytest.mark.ci("seeks three numbers, two of which act as one")
def test_what_the_log_cannot_tell_is_said(partly_found):
    found = partly_found
    (untold,) = found.unidentifiable
    assert set(untold.direction) == {"mass", "length"}
    assert untold.direction["mass"] == pytest.approx(-untold.direction["length"], rel=1e-2)
    assert np.isinf([found.standard_errors[name] for name in ("mass", "length")]).all()
    assert np.isfinite(found.standard_errors["stiffness"])
    assert unnamed(untold.text, "mass", "length") == []
    assert np.isfinite(found.correlations[2, 2])
    assert np.isnan(found.correlations[0, 2])


@pytest.mark.parametrize("turn", [0.0, 0.3, 1.2])
def test_combinations_that_are_not_told_have_a_number_each_of_their_own(turn):
    """Nothing tells the first number, nor the second against the third, whatever basis of both is found."""
    told = np.array([[0.0, 1.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    slightly = 1e-9 * np.array([np.cos(turn), np.sin(turn), -np.sin(turn), 0.0])
    matrix = 1e6 * told.T @ told + np.outer(slightly, slightly)
    found = Information(tuple("abcd"), matrix, matrix[None], np.ones(4, dtype=bool)).unidentifiable
    expected = {"a": {"a": 1.0}, "b": {"b": 1.0, "c": -1.0}, "c": {"b": -1.0, "c": 1.0}}
    assert len(found) == 2
    for each in found:
        largest = max(each.direction, key=lambda name: each.direction[name])
        assert each.direction == pytest.approx(expected[largest], abs=1e-6)
    alone = next(each for each in found if set(each.direction) == {"a"})
    assert unnamed(alone.text, "any value", "a") == []
    assert np.isinf(alone.standard_error)


@pytest.mark.ci("the log of an arm")
@pytest.mark.parametrize("seed", range(3))
def test_a_robot_that_stands_tells_nothing_of_its_spring(seed):
    robot = fh.load_robot("paper")
    rng = np.random.default_rng(seed)
    log = 1e-3 * np.arange(500), np.zeros(500), 1e-4 * rng.normal(size=500)
    found = fh.identify(robot, log, ("stiffness", "motor_inertia"))
    assert {name for untold in found.unidentifiable for name in untold.direction} == {
        "stiffness",
        "motor_inertia",
    }
    assert all(np.isinf(error) for error in found.standard_errors.values())


@pytest.mark.ci("the log of an arm")
@pytest.mark.parametrize(
    ("seed", "amplitude", "names"), [(1, 0.0, ("stiffness", "friction")), (2, 1e-5, ("friction",))]
)
def test_a_robot_that_stands_tells_nothing_of_its_friction(seed, amplitude, names):
    """A friction of 2,000 ± 650 N·m·s/rad was found, ten thousand times what is stated: all of them hold it."""
    robot = fh.load_robot("paper")
    rng = np.random.default_rng(seed)
    u = amplitude * rng.normal(size=(400, 1))
    log = 1e-3 * np.arange(400), u, 1e-4 * rng.normal(size=(400, 2))
    found = fh.identify(
        robot.with_values({"stiffness": 80.0, "friction": 0.2}),
        log,
        names,
        measured=("motor_position", "link_position"),
    )
    assert found.hidden == names


@pytest.mark.ci("fits a log twice")
def test_numbers_that_must_not_be_negative_are_not(arm):
    robot, _, _ = arm
    smooth = robot.with_values({"friction": 0.0})
    log = arm_log(smooth, seed=4, count=700)
    found = fh.identify(robot, log, ("friction",), measured=("link_position", "motor_position"))
    assert found.values["friction"] >= 0.0
    assert found.intervals["friction"][0] == 0.0
    assert found.intervals["friction"][1] < 1e-3


@pytest.mark.ci("a fit, which other tests share")
def test_a_saved_robot_has_the_numbers_and_their_intervals(arm, found, tmp_path):
    robot = arm[0]
    found.save(tmp_path / "arm.toml")
    saved = fh.load_robot(tmp_path / "arm.toml")
    for name in found.names:
        low, high = saved[name].interval
        assert low < saved[name].value < high
        assert saved[name].value == pytest.approx(found.values[name], abs=found.standard_errors[name])
        np.testing.assert_allclose((low, high), found.intervals[name], atol=found.standard_errors[name])
    assert saved["mass"] == robot["mass"]
    before = robot.file.read_text(encoding="utf-8").splitlines()
    after = (tmp_path / "arm.toml").read_text(encoding="utf-8").splitlines()
    assert sum(a != b for a, b in zip(before, after, strict=True)) == 4
    assert after[0] == before[0]


@pytest.mark.ci("shares what is found above")
def test_what_is_not_told_stays_as_it_was_stated(arm, partly_found, tmp_path):
    wrong = arm[1]
    partly_found.save(tmp_path / "arm.toml")
    saved = fh.load_robot(tmp_path / "arm.toml")
    assert (saved["mass"], saved["length"]) == (wrong["mass"], wrong["length"])


@pytest.mark.ci("a fit of its own")
def test_noises_may_be_held():
    log = linear_log(6)
    filter = fh.ExtendedKalmanFilter(oscillator(), PERIOD, np.diag([0.0, 1e-4]), 1e-4, [0.0, 0.0], 1.0)
    found = fh.identify(oscillator(**WRONG), log, ("stiffness",), filter=filter, noise=False)
    assert found.noise["position"] == pytest.approx(0.01)
    level = fh.identify(oscillator(**WRONG), log, tuple(WRONG), filter=filter)
    assert level.noise["process noise"] == pytest.approx(1.0, rel=0.4)


@pytest.mark.ci("a fit of its own")
def test_one_of_an_array_is_named_by_its_place():
    plant = fh.Plant(
        lambda x, u, d, p: np.array([x[1], -p.k[0] * x[0] - p.k[1] * x[1] + u[0]]), lambda x, u, p: x[:1],
        ("position", "velocity"), ("force",), parameters={"k": [30.0, 0.8]},
    )  # fmt: skip
    log = linear_log(7, gain=1.0, level=0.0)
    found = fh.identify(plant, log, ("k[1]",))
    assert found.values["k[1]"] == pytest.approx(40.0, rel=1e-2)
    assert set(fh.identify(plant, log, ("k",)).values) == {"k[1]", "k[2]"}


@pytest.mark.parametrize(
    ("arguments", "anchors"),
    [
        ({"parameters": ("stifness",)}, ("stifness", "stiffness")),
        ({"parameters": ()}, ("parameters",)),
        ({"parameters": ("stiffness",), "measured": ("motor",)}, ("motor",)),
        ({"parameters": ("stiffness",), "extras": ("rust",)}, ("rust",)),
        ({"parameters": ("stiffness",), "disturbance": 0.05, "process_noise": 1e-6}, ("process_noise",)),
    ],
)
def test_what_is_unknown_is_refused(arm, arguments, anchors):
    with refused_with(fh.InvalidInput, *anchors):
        fh.identify(arm[0], arm[2], **arguments)


def test_a_plant_has_no_sensors_to_choose_and_no_file():
    log = linear_log(8)
    with refused_with(fh.InvalidInput, "measured"):
        fh.identify(oscillator(), log, ("stiffness",), measured=("position",))
    with refused_with(fh.InvalidInput, "plant"):
        fh.identify(oscillator(), log, ("stiffness",)).save("arm.toml")


@pytest.mark.parametrize("logs", ci_and_night("identifies so many logs", [24], [400]))
def test_intervals_hold_the_truth_as_often_as_they_say(logs):
    inside = []
    for seed in range(logs):
        found = fh.identify(oscillator(**WRONG), linear_log(1000 + seed), tuple(WRONG))
        inside.append([low <= TRUE[name] <= high for name, (low, high) in found.intervals.items()])
    shares = np.mean(inside, axis=0)
    least, most = share(np.size(inside))
    assert least <= shares.mean() <= most, shares
    assert shares.min() > (0.9 if logs > 60 else 0.8)  # among 24, 95 % have a standard deviation of 4 %


@pytest.mark.ci("filters a log of two joints for each of two numbers, several times")
def test_springs_behind_a_coupling_are_found_from_the_motors_alone(tmp_path):
    """A belt on a table: each motor's angle is that of both links, and of its own spring."""
    robot = belt(tmp_path, gravity="0.0")
    times = 1e-3 * np.arange(500)
    torques = [25.0 * np.sin(3.0 * times) + 15.0 * np.sin(40.0 * times), 20.0 * np.sin(55.0 * times)]
    log = recorded(robot.plant("motor_position"), np.stack(torques, 1), noise=1e-5)
    true = {name: robot.nominal[name] for name in ("stiffness_shoulder", "stiffness_elbow")}
    wrong = robot.with_values({name: 1.3 * value for name, value in true.items()})
    found = fh.identify(wrong, log, tuple(true), measured="motor_position")
    for name, value in true.items():
        low, high = found.intervals[name]
        assert low - (high - low) < value < high + (high - low)
        assert found.standard_errors[name] < 0.01 * value


def test_corners_of_a_curve_in_the_wrong_order_are_refused():
    """The likeliest numbers of a log whose torques pass neither may be any."""
    curve = {"first_stiffness": 60.0, "second_stiffness": 90.0, "third_stiffness": 120.0}
    curve |= {"first_torque": 3.0, "second_torque": 8.0}
    robot = fh.load_robot("paper").with_parameters(*(Parameter(name, x) for name, x in curve.items()))
    numbers = robot_numbers(robot, ("first_torque", "second_torque"))
    unknowns = Unknowns(robot.plant(), robot, numbers, sought(linear_log(1, count=10))[1].noises)
    unknowns.check_corners(np.array([3.0, 8.0]))
    for corners in ([8.0, 3.0], [3.0, 3.0]):
        with refused_with(InvalidInput, "first_torque", "second_torque", "joint", *map(round, corners)):
            unknowns.check_corners(np.array(corners))
