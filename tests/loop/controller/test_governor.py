"""Joints that something held, that fall, or whose command jumps: they come back slowly, and the status says so.

Two links in the horizontal plane with unlike motors are integrated here, by their equations of motion.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.loop.conftest import LinearLaw
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.loop import Governor
from flexhinf.loop.controller.governor import MOST, TOUCH, believed, braked, governed, resisted, unwound
from flexhinf.loop.controller.measured import Source

# Kernels that run a few times.
pytestmark = pytest.mark.usefixtures("unoptimised")

PERIOD, EFFORT, SPEED = 1e-3, np.array([150.0, 12.0]), np.array([1.5, 4.0])
START, GOAL, TIME = np.array([-0.8, 1.9]), np.array([0.9, -0.6]), 2.5
STATES = tuple(f"link_{kind}_{joint}" for kind in ("position", "velocity") for joint in "ab")
BACK = Governor(
    (0.02 * SPEED).tolist(), (0.8 * SPEED).tolist(), (2.5 * SPEED).tolist(), [-2.5, -2.5], [2.5, 2.5]
)
WATCH = fh.Supervision(following=0.1 * SPEED, reactions={"following": "brake"})


def masses(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """M(q) (2, 2) and centrifugal torques (2,) of a heavy link that carries a light one."""
    c, s = 0.5 * np.cos(q[1]), 0.5 * np.sin(q[1])
    return (
        np.array([[8.0 + 2.0 * c, 0.4 + c], [0.4 + c, 0.4]]),
        np.array([-s * v[1] * (2.0 * v[0] + v[1]), s * v[0] ** 2]),
    )


def law() -> LinearLaw:
    """Poles of 12 rad/s for the masses at the start: a fast law, which knows no speed limit."""
    inertia, w = masses(START, np.zeros(2))[0], 12.0
    gain = np.hstack([3.0 * w**2 * inertia, 3.0 * w * inertia, w**3 * inertia])
    return LinearLaw((*STATES, *(f"link_position_{joint}_integral" for joint in "ab")), ("u", "v"), -gain)


def made(governor: Governor | None = BACK, **options: Any) -> fh.Controller:
    return fh.Controller(law(), None, PERIOD, EFFORT, moving=True, governor=governor, **options)


def command(time: float) -> np.ndarray:
    """The quintic from start to goal with its torques, (6,)."""
    t, way = min(time / TIME, 1.0), GOAL - START
    q = START + way * t**3 * (10.0 - 15.0 * t + 6.0 * t**2)
    v = way * 30.0 * t**2 * (1.0 - t) ** 2 / TIME
    a = way * 60.0 * t * (1.0 - t) * (1.0 - 2.0 * t) / TIME**2
    inertia, torque = masses(q, v)
    return np.concatenate([q, v, inertia @ a + torque])


def run(controller: fh.Controller, held: slice, load: float = 0.0, seconds: float = 6.0) -> dict[str, Any]:
    """Positions, speeds and status of a move whose command goes on, whatever the path rate says; joints are `held`."""
    x, rows = np.concatenate([START, np.zeros(2)]), []
    for k in range(round(seconds / PERIOD)):
        u = controller.step(x, command(PERIOD * k))
        rows.append((*x, int(controller.status), *controller.integrals))
        for _ in range(2):
            inertia, torque = masses(x[:2], x[2:])
            push = np.array([load, 0.0])
            x[2:] += 0.5 * PERIOD * np.linalg.solve(inertia, u + push - torque - [6.0, 0.3] * x[2:])
            x[2:] *= not held.start <= k < held.stop
            x[:2] += 0.5 * PERIOD * x[2:]
    table = np.array(rows)
    return {"q": table[:, :2], "v": table[:, 2:4], "status": table[:, 4].astype(int)}


HELD, NEVER = slice(1200, 1700), slice(0, 0)


@pytest.mark.ci("two moves of six seconds in Python")
def test_an_arm_that_is_held_and_let_go_comes_back_slowly_and_says_what_happened() -> None:
    """In the middle of a move somebody holds both joints for half a second; the program that makes the command does not
    read the path rate."""
    own, plain = (run(made(governor, supervision=WATCH), HELD) for governor in (BACK, None))
    lost, reacts = fh.Status.FOLLOWING_ERROR, fh.Status.FOLLOWING_ERROR | fh.Status.REACTING
    ends = np.array([np.minimum(START, GOAL), np.maximum(START, GOAL)])
    fastest = [np.abs(r["v"] / SPEED).max() for r in (own, plain)]
    assert fastest[0] < 1.0 < 1.5 < fastest[1]
    assert np.maximum(own["q"] - ends[1], ends[0] - own["q"]).max() < 0.01
    behind = np.abs(own["q"] - [command(PERIOD * k)[:2] for k in range(6000)]) > WATCH.following
    assert np.array_equal(own["status"] & lost > 0, behind.any(axis=1))
    assert not own["status"][: HELD.start].any()
    assert own["status"][HELD.stop] & reacts == reacts
    assert own["status"][-1] == fh.Status.REACTING
    assert own["q"][-1] == pytest.approx(GOAL, abs=1e-4)


@pytest.mark.ci("a kernel of its own")
def test_an_arm_that_a_wall_blocks_lets_go_where_a_following_error_holds_it() -> None:
    """Torque of the base on a wall of 2e5 N·m/rad that is put before it in mid-move, at 1.3 rad/s. It is said as soon
    as the command is 0.15 rad further. Braked, the arm pushes on with up to its motor's limit; held, with nothing."""
    pushed = {}
    for reaction, governor in (("brake", BACK), ("hold", None)):
        watch = fh.Supervision(following=0.1 * SPEED, reactions={"following": reaction})
        controller, x, wall, rows = (
            made(governor, supervision=watch),
            np.append(START, [0.0, 0.0]),
            np.inf,
            [],
        )
        for k in range(2000):
            u = controller.step(x, command(PERIOD * k))
            wall = x[0] if k == HELD.start else wall
            for _ in range(8):
                inertia, torque = masses(x[:2], x[2:])
                push = max(2e5 * (x[0] - wall) + 2e3 * x[2], 0.0) if x[0] > wall else 0.0
                torque += np.array([6.0 * x[2] + push, 0.3 * x[3]])
                x[2:] += 0.125 * PERIOD * np.linalg.solve(inertia, u - torque)
                x[:2] += 0.125 * PERIOD * x[2:]
            rows.append((push, fh.Status.FOLLOWING_ERROR in controller.status))
        pushed[reaction], said = np.array(rows).T
        assert 100 < np.flatnonzero(said)[0] - HELD.start < 130
    assert 0.8 * EFFORT[0] < pushed["brake"][-300:].max() < 1.3 * EFFORT[0]
    assert pushed["hold"][-500:].max() < 0.02 * EFFORT[0]


@pytest.mark.costs("two moves of six seconds in Python")
def test_a_load_that_it_does_not_know_is_carried_though_the_joint_falls_away() -> None:
    """0.6 of the motor's torque sags twice as far as the law is shown: integrals grow all the same."""
    weak, gain = made(supervision=WATCH), law().gain
    least = 0.02 * SPEED[0] * abs(gain[0, 0])
    fallen = run(weak, NEVER, load=0.6 * EFFORT[0])
    assert 0.6 * EFFORT[0] > 2.0 * least / 3.0
    assert np.abs(fallen["q"][-1] - GOAL).max() < 1e-3


def test_a_joint_that_follows_has_the_input_of_a_controller_without_it_bit_for_bit() -> None:
    own, plain, rng = made(supervision=WATCH), made(None, supervision=WATCH), np.random.default_rng(3)
    for k in range(2500):
        r = command(PERIOD * k)
        away = np.array(BACK.distance) * rng.uniform(-0.99, 0.99, 2)
        x = np.concatenate([r[:2] + away, r[2:4] + rng.standard_normal(2)])
        assert np.array_equal(own.step(x, r), plain.step(x, r))
        assert own.status == plain.status


def test_a_command_that_jumps_throws_no_joint() -> None:
    """The base's command jumps: the law is shown a motion within the limits, where else both motors are at theirs."""
    found = []
    for governor in (BACK, None):
        controller, x, most = made(governor, supervision=WATCH), np.concatenate([START, np.zeros(2)]), 0.0
        goal = np.concatenate([START, np.zeros(4)]) + 0.6 * np.eye(6)[0]
        for k in range(2000):
            u = controller.step(x, goal if k > 20 else np.concatenate([START, np.zeros(4)]))
            inertia, torque = masses(x[:2], x[2:])
            x[2:] += PERIOD * np.linalg.solve(inertia, u - torque)
            x[:2] += PERIOD * x[2:]
            most = max(most, abs(x[1] - START[1]))
        assert x[:2] == pytest.approx(goal[:2], abs=1e-3)
        found.append(most)
    assert found[0] < 0.01
    assert found[0] < 0.2 * found[1]


@pytest.mark.ci("many random commands")
def test_what_the_law_is_shown_keeps_speed_acceleration_range_and_distance() -> None:
    """Of joints and commands anywhere, in any order."""
    rng, places, tracked = (
        np.random.default_rng(5),
        ((0, 2, 0, 2), (1, 3, 1, 3)),
        [Source(True, 0, 0), Source(True, 1, 1)],
    )
    numbers, far = BACK.data(PERIOD), np.zeros(2)
    distance, most, gain, lower, upper, _ = numbers
    shown, seen, r, count = np.concatenate([START, np.zeros(4)]), START.copy(), np.zeros(6), 0
    for k in range(3000):
        if k % 1500 == 0:
            r = np.concatenate([rng.uniform(lower, upper), np.zeros(4)])
        seen = np.where(rng.random(2) < 0.3, seen, seen + 0.3 * (shown[:2] - seen))
        seen = seen if k % 700 else rng.uniform(lower, upper)
        before, behind = shown, np.abs(shown[:2] - seen) - distance
        shown, far, _ = governed(
            tracked, places, (), *2 * [np.append(seen, [0.0, 0.0])], r, r, before, far, np.ones(1), [PERIOD], numbers,
        )  # fmt: skip
        assert np.all(far[np.abs(r[:2] - seen) > distance] == 1.0)
        moved = far == 1.0
        apart = np.abs(shown[:2] - seen) - distance
        # A joint that jumps is followed at the largest speed.
        assert np.all(apart[moved] < np.maximum(behind - PERIOD * most, 0.0)[moved] + 1e-12)
        assert np.all(np.abs(shown[2:4]) <= most + 1e-12)
        smooth = moved & (before[2:4] != r[2:4])
        assert np.all(np.abs(shown[2:4] - before[2:4])[smooth] <= PERIOD * gain[smooth] * (1.0 + 1e-9))
        free = moved & (apart < -1e-9)
        assert np.all((shown[:2] >= np.minimum(lower, before[:2]))[free])
        assert np.all((shown[:2] <= np.maximum(upper, before[:2]))[free])
        assert np.array_equal(shown[:4][np.tile(~moved, 2)], r[:4][np.tile(~moved, 2)])
        count += int(moved.sum())
    assert 1000 < count < 5900


def test_a_late_joint_brakes_with_its_command() -> None:
    """Held while a command speeds up that is faster than the governor, it does not go on where that slows down."""
    rows, states, shown, far, seen = BACK.data(PERIOD), 6, np.zeros(6), np.zeros(2), np.zeros(2)
    places, tracked = ((0, 2, 0, 2), (1, 3, 1, 3)), [Source(True, 0, 0), Source(True, 1, 1)]
    before, beyond, brought = np.zeros(states), 0.0, 0
    for k in range(1500):
        t = min(PERIOD * k / 0.9, 1.0)
        r = np.zeros(states)
        r[0], r[2] = t**3 * (10.0 - 15.0 * t + 6.0 * t**2), 30.0 * t**2 * (1.0 - t) ** 2 / 0.9
        shown, far, _ = governed(
            tracked, places, (), np.append(seen, [0.0, 0.0]), shown[:4], r, before, shown, far,
            np.array([float(k > 0)]), [PERIOD], rows,
        )  # fmt: skip
        seen = seen if k < 150 else shown[:2].copy()
        before, beyond, brought = r, max(beyond, shown[0] - 1.0), brought + int(far[0])
    assert brought > 100
    assert beyond < 0.01


def held_by(push: Any, yields: Any, samples: int) -> np.ndarray:
    """Shares (N,) of the distance within which a joint is shown its motion: it is 0.2 rad from its command, kept back
    by an acceleration push(k), in units of the resistance, and moves away by yields(share) per sample."""
    grip, place, shares = np.outer([1.0, 0.0, 0.0, 0.0], np.ones(1)), 0.3, []
    for k in range(samples):
        seen = np.array([place, 0.0])
        grip = resisted(
            [Source(True, 0, 0)], ((0, 1, 0, 1),), seen, seen, np.array([0.5, 0.0, 0.0]),
            np.array([-PERIOD * 20.0 * push(k)]), grip, np.ones(1), [PERIOD], BACK.data(PERIOD)[:, :1],
            np.array([20.0]),
        )  # fmt: skip
        shares.append(grip[0, 0])
        place -= yields(shares[-1])
    return np.array(shares)


def test_a_joint_lets_go_of_an_obstacle_and_holds_a_load() -> None:
    """Below the resistance it grips; above, it has let go within 60 ms, and grips again where the obstacle is gone. A
    load that moves the joint further from its command is held, however large."""
    assert np.all(held_by(lambda k: 0.9, lambda share: 0.0, 500) == 1.0)
    stopped = held_by(lambda k: 3.0 * (k < 400), lambda share: 0.0, 1000)
    assert np.all(stopped[60:400] == 0.0)
    assert np.all(np.diff(stopped[430:]) >= 0.0)
    assert stopped[-1] == 1.0
    loaded = held_by(lambda k: 3.0, lambda share: 1e-3 * (1.0 - share), 500)
    assert 0.0 < loaded.min() < 0.5
    assert np.all(loaded[100:] == 1.0)


def test_a_blow_is_forgotten_as_soon_as_a_push_and_is_no_load() -> None:
    """Twenty resistances for 30 ms, which throw the joint back at 0.1 rad/s: it grips slowly all the same."""
    after = held_by(lambda k: 20.0 * (k < 30), lambda share: 1e-4, 130)[30:]
    assert after.max() < 0.3


def held_still(push: float, share: float, away: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The motion (4,) that is shown of a joint that is `away` from its command, in distances, whether it is brought
    back, and what counts of its velocity; the motion before went at the largest speed."""
    distance, speed = BACK.distance[0], BACK.speed[0]
    r, seen = np.zeros(5), np.array([-away * distance, 0.0, 0.0, 0.0])
    last = np.array([seen[0], speed, seen[0], speed, 0.0])
    hold = np.array([[share], [push], [0.0], [0.0]])
    shown, far, (_, _, heard) = governed(
        [Source(True, 0, 0)], ((0, 1, 2, 3),), (), seen, seen, r, r, last, np.zeros(1), np.ones(1), [PERIOD],
        BACK.data(PERIOD)[:, :1], hold,
    )  # fmt: skip
    return shown[:4], far, heard


def test_a_joint_that_much_resists_is_brought_back_sooner_and_slowly() -> None:
    """At half of the distance, where all of the resistance that is heard keeps it; what is estimated of its link's
    velocity counts not at all. Below, both are as they were, and far joints hear less, by the push on either side."""
    assert [float(held_still(push, 1.0, 0.5)[1][0]) for push in (MOST, -MOST, 0.99 * MOST)] == [1.0, 1.0, 0.0]
    assert [float(held_still(push, 1.0, 2.0)[2][0]) for push in (-1.0, 1.5, MOST)] == [1.0, 0.5, 0.0]
    assert held_still(1.5, 1.0, 0.5)[2] == 1.0
    slow, fast = (held_still(MOST, share, 2.0)[0][1] for share in (0.5, 1.0))
    assert slow == pytest.approx(0.5 * TOUCH * BACK.speed[0], rel=1e-12)
    assert fast > 0.9 * BACK.speed[0]


def test_velocities_of_links_behind_springs_count_by_a_share_and_of_rigid_ones_whole() -> None:
    places, x = ((0, 2, 4, 5), (1, 3, 1, 3)), np.arange(1.0, 9.0)
    heard = believed(places, np.array([0.25, 0.25]), x)
    assert np.array_equal(heard, x * [1.0, 1.0, 0.25, 1.0, 1.0, 1.0, 1.0, 1.0])
    assert np.array_equal(believed(places, np.ones(2), x), x)


@pytest.mark.ci("ten arms move for three seconds each, in Python")
def test_unlike_motors_that_all_saturate_come_back_slowly_on_ten_arms() -> None:
    """Random masses and motors, of which one is many times as strong as the other. Both links are held and let go, or
    stopped on one side, the drives give less than the controller knows, and both commands jump; several at once."""
    full = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        scale, unlike = rng.uniform(0.7, 1.5, 2), np.array([rng.uniform(60.0, 200.0), rng.uniform(6.0, 15.0)])
        inertia, w = masses(START, np.zeros(2))[0] * np.sqrt(np.outer(scale, scale)), 12.0
        gain = -np.hstack([3.0 * w**2 * inertia, 3.0 * w * inertia, w**3 * inertia])
        names = tuple(f"link_position_{joint}_integral" for joint in "ab")
        own = fh.Controller(
            LinearLaw((*STATES, *names), ("u", "v"), gain), None, PERIOD, unlike, moving=True, governor=BACK,
            supervision=WATCH,
        )  # fmt: skip
        power, begin, length = rng.uniform(0.6, 1.0, 2), rng.integers(300, 1200), rng.integers(20, 600)
        jumps = np.concatenate([rng.uniform(-0.4, 0.4, 2), np.zeros(4)]) * (seed % 3 == 0)
        kind, x, status, fastest, both = seed % 2, np.concatenate([START, np.zeros(2)]), 0, 0.0, 0
        for k in range(6000):
            u = own.step(x, command(PERIOD * k) + jumps * (k >= begin))
            both += int(np.all(np.abs(u) >= 0.999 * unlike))
            for _ in range(2):
                mass, torque = masses(x[:2], x[2:])
                mass = mass * np.sqrt(np.outer(scale, scale))
                given = np.clip(u, -power * unlike, power * unlike)
                x[2:] += 0.5 * PERIOD * np.linalg.solve(mass, given - torque - [6.0, 0.3] * x[2:])
                if begin <= k < begin + length:
                    x[2:] = np.zeros(2) if kind else np.where(x[2:] * (GOAL - START) > 0.0, 0.0, x[2:])
                x[:2] += 0.5 * PERIOD * x[2:]
            status |= int(own.status)
            fastest = max(fastest, float(np.abs(x[2:] / SPEED).max()))
        full += both > 0
        assert fastest < 1.2, seed
        assert x[:2] == pytest.approx(GOAL + jumps[:2], abs=2e-3), seed
        assert status & fh.Status.REACTING or length < 100, seed
    assert full >= 3


def test_an_integral_that_throws_a_joint_is_taken_back_and_one_that_carries_is_not() -> None:
    """Faster than is shown by all of the largest speed for 20 ms, towards where the integral drives, and the other
    way; and faster by a fifth, as noise may have it."""
    before = np.array([0.5, 0.5, 0.5, -0.5])
    after = before
    for _ in range(round(0.02 / PERIOD)):
        after = braked(after, np.array([-1.0, 1.0, -0.2, 1.0]), [PERIOD])
    assert np.array_equal(after[1:3], before[1:3])
    assert np.abs(after[[0, 3]]).max() < 0.15 * 0.5
    assert np.array_equal(np.sign(after), np.sign(before))


@pytest.mark.costs("four joints are held for two seconds, in Python")
@pytest.mark.parametrize("held", [0.5, 2.0])
def test_a_joint_that_comes_loose_keeps_its_speed_limit_with_slow_and_fast_laws(held: float) -> None:
    """Two joints whose motors reach their speed limits, 1.5 and 3 rad/s, within 80 and 4 ms, with laws of 8 and
    50 rad/s, or 15 and 30. Brakes hold both in mid-move, and integrals fill their motors."""
    inertia, effort, speed = np.array([8.0, 0.02]), np.array([150.0, 16.0]), np.array([1.5, 3.0])
    governor = replace(
        BACK,
        distance=(0.02 * speed).tolist(),
        speed=(0.8 * speed).tolist(),
        acceleration=(2.7 * speed).tolist(),
    )
    for w in np.array([[8.0, 50.0], [15.0, 30.0]]):
        gain = -np.hstack([np.diag(inertia * k) for k in (2.0 * w**2, 2.0 * w, w**3)])
        loop = LinearLaw(law().state_names, ("u", "v"), gain)
        own = fh.Controller(loop, None, PERIOD, effort, moving=True, governor=governor, supervision=WATCH)
        x, fastest, filled, begin = np.zeros(4), np.zeros(2), np.zeros(2, dtype=bool), 500
        end = begin + round(held / PERIOD)
        for k in range(end + 1500):
            t = min(PERIOD * k, 1.2)
            u = own.step(x, np.array([0.5 * t, 1.2 * t, 0.5 * (t < 1.2), 1.2 * (t < 1.2), 0.0, 0.0]))
            filled |= np.abs(u) >= 0.999 * effort
            for _ in range(2):
                x[2:] += 0.5 * PERIOD * u / inertia
                x[2:] *= not begin <= k < end
                x[:2] += 0.5 * PERIOD * x[2:]
            fastest = np.maximum(fastest, np.abs(x[2:]) / speed)
        assert filled[1]
        assert fastest.max() < 1.1
        assert x[:2] == pytest.approx([0.6, 1.44], abs=5e-3)


def test_what_takes_an_integral_back_counts_from_the_command() -> None:
    """An error of 1 that is 1.3 of the command takes a negative integral back by 1.3; any other counts as shown."""
    error, integral, lag = np.array([1.0, 1.0, 1.0, -1.0]), np.array([-1.0, -1.0, 1.0, 1.0]), 0.3
    found = unwound(error, integral, np.array([lag, -lag, lag, -lag]))
    assert found == pytest.approx([1.3, 1.0, 1.0, -1.3])


def test_it_is_saved_copied_named_and_refused(tmp_path: Path) -> None:
    controller = made()
    controller.save(tmp_path / "controller")
    x, r = np.concatenate([START, np.zeros(2)]), command(1.0)
    for same in (fh.load_controller(tmp_path / "controller"), controller.fresh()):
        assert same.governor == BACK
        assert np.array_equal(same.step(x, r), made().step(x, r))
    assert "brought back" in repr(controller)
    with refused_with(InvalidInput, "governor", "moving=True", "command_rate"):
        fh.Controller(law(), None, PERIOD, EFFORT, governor=BACK)
    hold = fh.Supervision(following=0.2, reactions={"following": "hold"})
    with refused_with(InvalidInput, "governor", "'hold'", "brake"):
        made(supervision=hold)
    with refused_with(InvalidInput, "governor", "-1.0"):
        Governor([0.1], [-1.0], [1.0], [0.0], [1.0])


def test_what_resists_a_joint_is_seen_in_its_velocity_in_the_estimate() -> None:
    own, estimator = (5, 3, 4, 2), SimpleNamespace()
    places, seen, *_ = replace(BACK, resistance=[20.0, 20.0]).places(law(), True, None, own, estimator)  # type: ignore[arg-type]
    names = [[STATES[place] for place in row[:2]] for row in places]
    assert names == [[f"link_{kind}_{joint}" for kind in ("position", "velocity")] for joint in "ab"]
    assert seen == tuple(own[STATES.index(f"link_velocity_{joint}")] for joint in "ab")


def test_motors_of_coupled_joints_are_shifted_as_these_joints_turn_them() -> None:
    tracked, places = [Source(True, 0, 0), Source(True, 1, 1)], ((0, 2, 4, 6), (1, 3, 5, 7))
    turned, seen, r = ((1.0, 0.0), (1.0, 1.0)), np.array([0.9, -1.4]), np.zeros(10)
    shown, far, _ = governed(
        tracked, places, turned, np.append(seen, [0.0, 0.0]), np.append(seen, np.zeros(6)), r, r, r, np.zeros(2),
        np.zeros(1), [PERIOD],
        BACK.data(PERIOD),
    )  # fmt: skip
    assert np.array_equal(far, [1.0, 1.0])
    assert np.abs(shown[:2]).min() > 0.0
    np.testing.assert_allclose(shown[4:6], np.array(turned) @ shown[:2], rtol=1e-12)
    np.testing.assert_allclose(shown[6:8], np.array(turned) @ shown[2:4], rtol=1e-12)
