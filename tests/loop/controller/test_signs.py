"""Signs of a protective stop: an arm of one elastic joint, integrated here by its equations, with faults and without.

The arm is the paper's: link and rotor of 1 kg·m², a spring of 100 N·m/rad, 9.8 N·m of weight, 0.9 N·m/V, 1 N·m·s/rad.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.builders import arm_controller

import flexhinf as fh
from flexhinf.export import protected
from flexhinf.loop.controller.readings import Readings
from flexhinf.loop.controller.signs import opposed, oscillating
from flexhinf.loop.controller.stop import LONGEST
from flexhinf.stops import Stop

pytestmark = pytest.mark.usefixtures("unoptimised")

PERIOD, NOISE, POSE, LIMIT = 1e-3, 1e-5, 0.6, 24.0
WEIGHT, STIFFNESS, GAIN = 9.8, 100.0, 0.9


def made(**options: Any) -> fh.Controller:
    """A controller that holds the arm by both encoders, with the protection of the robot's file."""
    robot = fh.load_robot("paper")
    plain = arm_controller(
        robot, fh.ExtendedKalmanFilter, pose=POSE, measured=("link_position", "motor_position"), limit=LIMIT,
        q=1e-7, r=NOISE**2, supervision=fh.Supervision((-2.0, 2.0), following=0.2), offset_time=0.5,
    )  # fmt: skip
    return protected(plain, robot, np.array([2.0]))[0].fresh(**options)


class Arm:
    """Link and motor, with what may be wrong with them."""

    def __init__(self, at: float = POSE, seed: int = 1) -> None:
        self.x = np.array([at, 0.0, at + WEIGHT / STIFFNESS * math.sin(at), 0.0])
        self.rng, self.held = np.random.default_rng(seed), 0
        self.stiffness, self.drive, self.load, self.free = STIFFNESS, 1.0, 0.0, 0.0

    def run(self, u: float, seconds: float = PERIOD) -> np.ndarray:
        """What its encoders read after a time, by steps of 0.1 ms; dry friction of the motor is 0.2 N·m."""
        x, h = self.x, 1e-4
        for _ in range(round(seconds / h)):
            spring = self.stiffness * (x[2] - x[0])
            dry = 0.2 * math.tanh(x[3] / 1e-2)
            x[1] += h * (spring - WEIGHT * math.sin(x[0]) + self.load)
            x[3] += h * (GAIN * self.drive * u + self.free - x[3] - spring - dry)
            x[1] *= not self.held
            x[0] += h * x[1]
            x[2] += h * x[3]
        return x[[0, 2]] + NOISE * self.rng.standard_normal(2)


#: At what sample something happens, and for how long it is looked at.
AT, LONG = 400, 600

Happening = Callable[[Arm, np.ndarray, int], np.ndarray]


def runs(
    controller: fh.Controller, happens: Happening, target: float = POSE + 0.1, seconds: float = 1.0
) -> dict[str, Any]:
    """A step of the command; from sample `AT` on something happens to arm or readings. What is said, and when."""
    arm, u, first, q = Arm(), controller.input_before(), 0, []
    controller.reset(pose=[POSE])
    y = arm.run(float(u[0]))
    for k in range(round(seconds / PERIOD)):
        seen = happens(arm, y.copy(), k) if k >= AT else y
        new = controller.step(seen, [target if k > 50 else POSE])
        if not controller.may_act() and not first:
            first = k
        first = first or (k if controller.stop else 0)
        y = arm.run(float(u[0]))
        u = controller.output if controller.stop else new
        q.append(arm.x[0])
    return {
        "stop": controller.stop,
        "after": first - AT if first else None,
        "q": np.array(q),
        "stop_record": controller.counts,
    }


def read(place: int, change: Callable[[float, int], float]) -> Happening:
    def happens(arm: Arm, y: np.ndarray, k: int) -> np.ndarray:
        y[place] = change(y[place], k - AT)
        return y

    return happens


def set_to(**values: float) -> Happening:
    def happens(arm: Arm, y: np.ndarray, k: int) -> np.ndarray:
        vars(arm).update(values)
        return y

    return happens


def stuck(place: int) -> Happening:
    kept: list[float] = []
    return read(place, lambda value, k: kept[0] if kept else (kept.append(value) or value))


FAULTS = {
    "link jumps": read(0, lambda y, k: y + 0.2),
    "motor jumps": read(1, lambda y, k: y - 0.3),
    "link is reversed": read(0, lambda y, k: -y),
    "motor reads zero": read(1, lambda y, k: 0.0),
    "link drifts": read(0, lambda y, k: y + 1e-3 * k),
    "motor is scaled": read(1, lambda y, k: 1.2 * y),
    "link is silent": read(0, lambda y, k: math.nan),
    "link is wild": read(0, lambda y, k: y + 0.5 * (k % 2)),
    "drive is dead": set_to(drive=0.0),
    "drive is reversed": set_to(drive=-1.0),
    "drive is full on": set_to(drive=0.0, free=GAIN * LIMIT),
    "spring is broken": set_to(stiffness=1.0),
}


@pytest.mark.oracle
@pytest.mark.quick_cases(4)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_noticed_before_the_arm_has_gone_far(fault: str) -> None:
    """Within 50 ms, or before the link is 0.1 rad from where it would be without it."""
    plain, found = runs(made(), lambda arm, y, k: y), runs(made(), FAULTS[fault])
    assert not plain["stop"]
    assert plain["stop_record"].stop_sample == 0
    assert found["after"] is not None
    gone = np.abs(found["q"] - plain["q"])[: AT + found["after"] + 1].max()
    assert found["after"] <= 50 or gone < 0.1
    assert found["stop_record"].stop_sample > 0 or found["stop"] & (Stop.STEP_FAILED | Stop.WRONG_PERIOD)


@pytest.mark.oracle
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("seed", range(3))
def test_a_robot_within_its_tolerances_is_not_stopped(seed: int) -> None:
    """Nor one whose link is held and let go, or pushed, or whose command is far."""
    rng = np.random.default_rng(seed)
    stiffness = STIFFNESS * rng.uniform(0.9, 1.1)
    for happens, target in (
        (set_to(stiffness=stiffness), POSE + 0.4),
        (lambda arm, y, k: set_to(held=float(k < AT + 300), stiffness=stiffness)(arm, y, k), POSE + 0.2),
        (lambda arm, y, k: set_to(load=1.0 * (k < AT + 100))(arm, y, k), POSE),
    ):
        found = runs(made(), happens, target)
        assert not found["stop"], str(found["stop"])


def test_what_stopped_stays_until_a_new_start() -> None:
    controller = made()
    found = runs(controller, read(0, lambda y, k: y + 0.3 * (k < 30)))
    assert found["stop"] == Stop.SENSOR_LOST  # though its readings are right again
    assert pickle.loads(pickle.dumps(controller)).stop == Stop.SENSOR_LOST
    controller.reset(pose=[POSE])
    assert not controller.stop
    controller.step(Arm().run(0.0, 0.0), [POSE])
    assert controller.may_act()


def test_nothing_stops_for_a_reason_that_does_not_count() -> None:
    one = made()
    assert one.protection is not None
    free = one.fresh(protection=replace(one.protection, stop_on=("too_fast",)))
    found = runs(free, read(0, lambda y, k: y + 0.3))
    assert not found["stop"]
    assert found["stop_record"].stop_sample == 0
    assert runs(free, read(0, lambda y, k: y + 0.3), seconds=0.43)["stop_record"].stop_sample == 0
    assert fh.Status.SENSOR_LOST in free.status


@pytest.mark.parametrize(("brakes", "category"), [(True, 0), (False, 1)])
def test_the_category_of_a_stop(brakes: bool, category: int) -> None:
    """With brakes the power goes at once; without, the arm is slowed down first, and rests where it was."""
    one = made()
    assert one.protection is not None
    stopped = one.fresh(protection=replace(one.protection, brakes=(brakes,)))
    assert stopped.protection is not None
    assert stopped.protection.category == category
    arm, power, speeds = Arm(), [], []
    stopped.reset(pose=[POSE])
    u = stopped.input_before()
    for k in range(1_500):
        y = arm.run(float(u[0]))
        y[0] = math.nan if k > AT else y[0]
        stopped.step(y, [POSE + (0.2 if k > AT - 100 else 0.0)])
        power.append(stopped.may_act())
        u = stopped.output
        speeds.append(abs(arm.x[1]))
    off = power.index(False)
    assert not any(power[off:])
    begins = AT + 11
    assert off == begins if brakes else begins + 50 <= off <= begins + LONGEST / PERIOD + 1
    assert float(u[0]) == 0.0
    if not brakes:
        assert speeds[off - 1] < 0.05 < max(speeds)


def test_a_controlled_stop_that_makes_the_arm_faster_ends_at_once() -> None:
    """A drive that is reversed drives the arm by what should slow it down."""
    found = runs(made(), set_to(drive=-1.0), seconds=0.8)
    assert found["stop"]
    assert np.abs(np.diff(found["q"])).max() / PERIOD < 2.0


def test_a_sensor_is_believed_again_where_its_readings_go_on_from_the_last_one() -> None:
    """A blow makes the link faster than its largest speed; a sensor that jumps as far stays refused."""

    def blow(arm: Arm, y: np.ndarray, k: int) -> np.ndarray:
        arm.x[1] += 8.0 * (k == AT)
        return y

    struck, jumped = made(), made()
    runs(struck, blow, seconds=0.41)
    runs(jumped, read(0, lambda y, k: y + 0.08), seconds=0.41)
    for one, refused, lost in ((struck, 5, False), (jumped, 9, True)):
        kept = Readings(*one.memory.named(one._history.memory).readings)
        assert bool(kept.refused[0] <= refused) is not lost
        assert bool(kept.since[0] > 1) is lost


def test_a_robot_elsewhere_than_the_controller_begins_is_no_start() -> None:
    for away, stops in ((0.02, False), (0.15, True)):
        controller, arm = made(), Arm(POSE + away)
        controller.reset(pose=[POSE])
        controller.step(arm.run(0.0, 0.0), [POSE])
        assert controller.may_act() is not stops or controller.stop == Stop.BAD_START
        assert bool(controller.stop) is stops


def test_a_pause_of_the_loop_is_no_fault_where_it_is_known() -> None:
    """The arm went on for 0.3 s with one input; its readings are believed at once, and taken in slowly."""
    controller, arm = made(), Arm()
    controller.reset(pose=[POSE])
    u = controller.input_before()
    for k in range(3_000):
        y = arm.run(float(u[0]), 0.3 if k == AT else PERIOD)
        u = controller.step(y, [POSE + (0.2 if k > 350 else 0.0)], elapsed=0.3 if k == AT else PERIOD)
        assert controller.may_act(), str(controller.stop)
    assert abs(arm.x[0] - POSE - 0.2) < 0.02


@pytest.mark.ci("compiles a library")
def test_power_and_reasons_are_those_of_the_compiled_controller(tmp_path: Any) -> None:
    """Which are decided by the C, with its bits: readings that are not fresh, a pause, a fault and what follows."""
    from flexhinf.export import compile_controller, load_compiled

    controller = made()
    library = load_compiled(compile_controller(controller, tmp_path / "arm.so"))
    for one in (controller, library):
        one.reset(state=controller.law.operating_point[:4], input=controller.input_before())
    rng, arm, u = np.random.default_rng(5), Arm(), controller.input_before()
    for k in range(1_100):
        y = arm.run(float(u[0]))
        y[1] += 0.4 * (k > 700)
        fresh = rng.integers(-1, 2, 2) if k % 7 == 0 else None
        elapsed = 5e-3 if k == 300 else PERIOD if k > 200 else 0.0
        args = (None if k % 50 == 0 else y, [POSE + 0.1 * (k > 100)], elapsed, fresh)
        assert np.array_equal(controller.step(*args), library.step(*args)), k
        assert controller.may_act() == library.may_act(), k
        assert (controller.stop, int(controller.status)) == (library.stop, library.status), k
        u = controller.output
        assert library.output == pytest.approx(u, abs=1e-9), k
    assert controller.stop
    assert library.counts == controller.counts


def swung(values: Sequence[float], small: float, large: float) -> bool:
    """Whether inputs, one for each millisecond, are called an oscillation."""
    state, found = np.array([[values[0]], [values[0]], [1.0], [0.0], [0.0], [0.0]]), np.zeros(1)
    for value in values:
        sizes, period = np.array([[small], [large]]), np.array([1e-3])
        state, flag = oscillating(np.array([value]), state, period, sizes)
        found = np.maximum(found, flag)
    return bool(found[0])


def test_swings_that_do_not_grow_are_noise_and_large_ones_are_not() -> None:
    """Behind a rest the first swing is not one that grows, whatever came before it."""
    rng = np.random.default_rng(2)
    rest = [0.0] * 400
    assert not swung([*rest, *(1.5 * rng.uniform(-1.0, 1.0, 400)), *rest], 1.0, 20.0)
    assert not swung([*rest, *(2.0 * (-1.0) ** k * 1.1**k for k in range(5)), *rest], 1.0, 20.0)
    assert swung([*rest, *(2.0 * (-1.0) ** k * 1.3**k for k in range(9))], 1.0, 20.0)
    assert swung([*rest, *(11.0 * (-1.0) ** k for k in range(8))], 1.0, 20.0)


def opposes(speeds: Sequence[Sequence[float]], place: int) -> bool:
    """Whether an input at its upper limit is opposed, by speeds (rad/s) of a motor and its link at each millisecond."""
    held, found = np.zeros((2, 1)), np.zeros(1)
    for row in speeds:
        readings = np.zeros((len(Readings._fields), 2))
        readings[Readings._fields.index("speed")] = 1e-3 * np.array(row)
        held, flag = opposed(
            [place], np.array([5.0]), readings, held, np.array([-5.0]), np.array([5.0]), np.full((2, 1), 0.1),
            np.array([1e-3]), np.array([3.0, 3.0]),
        )  # fmt: skip
        found = np.maximum(found, flag)
    return bool(found[0])


def test_a_motor_that_its_spring_carries_is_no_reversed_drive() -> None:
    """A push: the link slows down while the motor is carried; and a drive that pushes the wrong way moves both."""
    t, watch = np.linspace(0.0, 1.0, 60), made().mode.protected
    assert watch is not None
    assert (watch.moved, watch.driven) == ((1,), (0,))  # of the readings of link and motor
    pushed = np.column_stack([-2.0 * t, -5.0 + 4.0 * t])
    assert not opposes(pushed.tolist(), 1)
    assert opposes(pushed.tolist(), 0)  # what its motor alone would say
    assert opposes(np.column_stack([-4.0 * t, -3.0 * t]).tolist(), 1)
    assert not opposes((0.01 * np.sin(40.0 * pushed)).tolist(), 1)  # it stands
