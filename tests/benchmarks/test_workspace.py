"""``make bench-workspace``: two simulators, goals, laws, linear loops, and metrics."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.workspace import rows as the_rows
from benchmarks.workspace.arm import PERIOD, Arm
from benchmarks.workspace.goals import REST, Move, Reference, goals, moves, planned, poses, steps
from benchmarks.workspace.laws import LAWS, SHARES, DifferenceLaw, FlatnessLaw, Law, Overcoming
from benchmarks.workspace.linear import MARGINS, closed, damping, judged, late, outputs
from benchmarks.workspace.metrics import PUSHED, TAIL, metrics, summary
from benchmarks.workspace.plants import PLANTS, MuJoCo, RungeKutta
from benchmarks.workspace.robots import ROBOTS, true_arms
from benchmarks.workspace.trip import CONDITIONS, Condition, trip
from scipy.integrate import solve_ivp

import flexhinf as fh
from flexhinf.analysis import EquilibriumLoop

PLANAR, SCARA = "planar-two-link", "scara"


@pytest.fixture(scope="module")
def control() -> Any:
    """python-control, which takes long to import."""
    return import_module("control")


@pytest.fixture(scope="module")
def arms() -> dict[str, Arm]:
    return {name: Arm.of(ROBOTS[name].robot()) for name in (PLANAR, SCARA)}


def short(arm: Arm, seed: int = 0) -> Move:
    """A move that takes half a second."""
    goal = arm.home + 0.02 * (arm.upper - arm.lower) * np.random.default_rng(seed).choice([-1.0, 1.0], arm.n)
    return moves(arm, goal[None])[0]


# The robot ----------------------------------------------------------------------------------------
@pytest.mark.oracle
@pytest.mark.parametrize("name", [PLANAR, SCARA, "paper", "seven-link"])
def test_the_arm_has_the_numbers_of_its_robot(name: str) -> None:
    """Equilibrium and linear model by Pinocchio against flexhinf's."""
    robot = ROBOTS[name].robot()
    arm = Arm.of(robot)
    extras = ("joint_damping",) if np.any(arm.spring_damping) else ()
    for q in poses(arm, 3, 5):
        state, held = robot.operating_point(q)
        theta, mine = arm.rest(q)
        assert theta == pytest.approx(state[2 * arm.n : 3 * arm.n], abs=1e-12)
        assert mine == pytest.approx(held, abs=1e-9)
        a, b, *_ = robot.plant(extras=extras).linearise(state, held)
        for one, other in zip(arm.linear(q), (a, b)):
            assert one == pytest.approx(other, rel=1e-9, abs=1e-9 * np.abs(other).max())


def test_a_robot_without_limits_is_refused() -> None:
    with pytest.raises(fh.InvalidInput, match="spatial-three-link"):
        Arm.of(fh.load_robot("spatial-three-link"))


@pytest.mark.parametrize("name", [PLANAR, SCARA])
def test_sampled_robots_are_at_the_ends_of_their_tolerances_and_rigid_bodies(name: str) -> None:
    nominal, found = Arm.of(ROBOTS[name].robot()), true_arms(ROBOTS[name], "sampled")
    assert len(found) == 8
    for arm in found:
        PLANTS["mujoco"](arm)  # refuses moments of inertia that no body has
        assert np.all(arm.stiffness != nominal.stiffness)
    loaded = true_arms(ROBOTS[name], "payload")[0]
    assert loaded.mass.sum() == pytest.approx(nominal.mass.sum() + 1.0)


# Goals --------------------------------------------------------------------------------------------
def test_goals_are_within_the_range_and_hold_the_payload() -> None:
    arm = Arm.of(replace(ROBOTS[PLANAR].robot(), effort_limits=(6.0, 4.0)))
    loaded = Arm.of(replace(ROBOTS[PLANAR].robot(payload=True), effort_limits=(6.0, 4.0)))
    many, left = goals(arm, loaded, 60)
    few, _ = goals(arm, loaded, 5)
    assert np.array_equal(many[:5], few)
    assert left > 0
    assert np.all((many > arm.lower) & (many < arm.upper))
    needed = np.array([np.abs(loaded.rest(q)[1]) / loaded.limit for q in many])
    assert np.all(needed <= 0.7)
    every = np.random.default_rng(0).uniform(arm.lower, arm.upper, (500, 2))
    share = np.mean([np.any(np.abs(loaded.rest(q)[1]) > 0.7 * loaded.limit) for q in every])
    assert left / (left + 60) == pytest.approx(share, abs=0.15)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("name", [PLANAR, SCARA])
def test_a_move_is_at_half_the_speed_limits_and_its_feedforward_drives_the_frictionless_robot(
    arms: dict[str, Arm], name: str
) -> None:
    arm = arms[name]
    way = moves(arm, goals(arm, arm, 2)[0])[1]
    speeds = np.abs(way.states[:, arm.n : 2 * arm.n]).max(axis=0) / arm.speed
    assert speeds.max() == pytest.approx(0.5, rel=1e-5)
    assert way.states[0, : arm.n] == pytest.approx(way.start)
    assert way.states[-round(REST / PERIOD), : arm.n] == pytest.approx(way.goal, abs=1e-9)
    # Slow, because a quintic's jerk jumps at its ends, which no elastic joint follows
    move = planned(arm, arm.home, short(arm).goal, 1, 4.0)
    plant = RungeKutta(replace(arm, spring_damping=np.zeros(arm.n)), friction=False)  # feedforward knows none
    plant.rest(move.start)
    queue, worst = [arm.rest(move.start)[1]], 0.0
    for k in range(len(move) - round(REST / PERIOD)):
        worst = max(worst, float(np.abs(plant.read()[0] - move.states[k, : arm.n]).max()))
        queue.append(move.inputs[k])
        plant.advance(queue.pop(0))
    assert worst < 2e-4 * float(np.abs(move.goal - move.start).max())


def test_a_law_is_told_where_the_robot_is_to_be_when_its_input_acts(arms: dict[str, Arm]) -> None:
    move = short(arms[SCARA])
    for k in (0, 100, len(move) - 1):
        state, _, ahead = move.reference(k)
        assert np.array_equal(state, move.states[k])
        assert np.array_equal(ahead, move.states[min(k + 1, len(move) - 1)])
    late = planned(arms[SCARA], move.start, move.goal, 3, 0.5)
    assert np.array_equal(late.reference(10).ahead, move.states[13])


def test_bare_steps_move_one_joint(arms: dict[str, Arm]) -> None:
    arm = arms[SCARA]
    for one in steps(arm, poses(arm, 5)):
        moved = one.goal - one.start
        assert np.count_nonzero(moved) == 1
        assert np.abs(moved / (arm.upper - arm.lower)).max() == pytest.approx(0.02)
        assert np.all((one.goal > arm.lower) & (one.goal < arm.upper))


# Two simulators -----------------------------------------------------------------------------------
@pytest.mark.oracle
@pytest.mark.parametrize("name", [PLANAR, SCARA])
@pytest.mark.parametrize("friction", [False, True])
def test_both_simulators_move_alike(arms: dict[str, Arm], name: str, friction: bool) -> None:
    """A quarter of a second, pushed: they differ by less than 1e-3 of the motion, with dry friction by 4e-3."""
    arm, move, found = arms[name], short(arms[name]), []
    for kind in (MuJoCo, RungeKutta):
        plant = kind(arm, friction)
        plant.rest(move.start)
        run = []
        for k in range(250):
            plant.advance(move.inputs[k], 0.1 * arm.limit * arm.per_input)
            run.append(np.concatenate(plant.read()))
        found.append(np.array(run))
    moved = np.abs(found[0] - np.concatenate([move.start, move.start])).max(axis=0)
    assert np.all(moved > 1e-3)
    assert np.all(np.abs(found[0] - found[1]).max(axis=0) < (4e-3 if friction else 1e-3) * moved)


@pytest.mark.oracle
def test_runge_kutta_is_scipys_solution(arms: dict[str, Arm]) -> None:
    arm, q = arms[SCARA], arms[SCARA].home
    plant = RungeKutta(arm, friction=False)
    plant.rest(q)
    x, n, u = plant.x.copy(), arm.n, arm.rest(q)[1] + 0.1 * arm.limit

    def rate(_: float, x: np.ndarray) -> np.ndarray:
        q, dq, theta, dtheta = np.split(x, 4)
        spring = arm.stiffness * (theta - q) + arm.spring_damping * (dtheta - dq)
        motor = (arm.per_input * u - arm.viscous * dtheta - spring) / arm.rotor
        return np.concatenate([dq, arm.acceleration(q, dq, spring), dtheta, motor])

    for _ in range(50):
        plant.advance(u)
    wanted = solve_ivp(rate, (0.0, 0.05), x, rtol=1e-10, atol=1e-12).y[:, -1]
    assert np.abs(wanted[:n] - q).max() > 1e-3
    assert plant.x == pytest.approx(wanted, rel=1e-4, abs=1e-5)


def test_a_law_that_overcomes_dry_friction_stays_nearer_to_its_path(arms: dict[str, Arm]) -> None:
    """By the planned speed of each motor at the instant at which the input acts; at rest it adds nothing."""
    arm = arms[PLANAR]
    move = planned(arm, arm.home, arm.home + 0.2, 1, 0.5)
    bare = DifferenceLaw(arm, True, 0.3)
    errors = []
    for law in (bare, Overcoming(bare, arm)):
        run = trip(lambda true: PLANTS["mujoco"](true, True), law, [arm], [move], CONDITIONS["nominal"])
        errors.append(run.moves[0].path)
    assert errors[1] < 0.5 * errors[0]
    law.start(move.goal)
    y, held = np.concatenate([move.goal, arm.rest(move.goal)[0]]), arm.rest(move.goal)[1]
    np.testing.assert_allclose(law.step(y, move.reference(len(move) - 1)), held, rtol=1e-6)


def test_dry_friction_holds_a_motor_up_to_its_limit(arms: dict[str, Arm]) -> None:
    arm = arms[PLANAR]
    for kind in PLANTS.values():
        for share, moves_on in ((0.9, False), (1.5, True)):
            plant = kind(arm)
            plant.rest(arm.home)
            before = plant.read()[1]
            for _ in range(300):
                plant.advance(arm.rest(arm.home)[1] + share * arm.dry / arm.per_input)
            moved = np.abs(plant.read()[1] - before)
            assert np.all(moved > 1e-3) if moves_on else np.all(moved < 2e-5)


# Linear loops -------------------------------------------------------------------------------------
def choices(arm: Arm, links: bool) -> dict[str, Law]:
    """Each rival by every set of numbers that its candidates differ in, beside bandwidths."""
    found = {}
    for name, choice in LAWS.items():
        if choice.tuned and (links or not choice.needs_links):
            for numbers in choice.candidates[0]:
                rest = {key: value for key, value in numbers.items() if key not in ("share", "w")}
                first = {"share": 0.3} if "share" in numbers else {"w": 28.0}
                found[f"{name} {rest}"] = choice.make(arm, links, **first | rest)
    return found


@pytest.mark.parametrize("name", [PLANAR, SCARA])
@pytest.mark.parametrize("links", [True, False])
def test_the_linear_model_of_a_law_is_what_its_steps_do(arms: dict[str, Arm], name: str, links: bool) -> None:
    arm, rng = arms[name], np.random.default_rng(0)
    q = poses(arm, 1, 4)[0]
    theta, held = arm.rest(q)
    rest = np.concatenate([q, 0.0 * q, theta, 0.0 * q])
    reference = Reference(rest, held, rest)
    seen = np.concatenate([q, theta]) if links else theta
    for law in choices(arm, links).values():
        law.start(q)
        law.step(seen, reference)  # at rest: the first sample has none before it
        a, b, c, d = law.linear(q)
        x = np.zeros(len(a))
        for _ in range(40):
            y = 1e-9 * rng.standard_normal(len(seen))
            u = law.step(seen + y, reference) - held
            wanted, x = c @ x + d @ y, a @ x + b @ y
            assert u == pytest.approx(
                wanted, rel=1e-4, abs=1e-6 * np.abs(d).max() * 1e-9 + 1e-12 * arm.limit.max()
            )


@pytest.mark.oracle
@pytest.mark.parametrize("name", [PLANAR, SCARA])
def test_damping_is_that_of_an_independent_loop(arms: dict[str, Arm], control: Any, name: str) -> None:
    """python-control samples the plant, delays its input and closes the loop."""
    arm = arms[name]
    for law in choices(arm, True).values():
        q = poses(arm, 1, 8)[0]
        a, b = arm.linear(q)
        c = outputs(arm.n)
        plant = control.sample_system(control.ss(a, b, c, 0.0), PERIOD, "zoh")
        zero = np.zeros((arm.n, arm.n))
        queue = control.ss(zero, np.eye(arm.n), np.eye(arm.n), zero, PERIOD)
        loop = control.feedback(plant * queue, control.ss(*law.linear(q), PERIOD), sign=1)
        z = loop.poles()
        s = np.log(z[np.abs(z) > 1e-9].astype(complex)) / PERIOD
        counts = (np.abs(s.imag) > 2.0) & (np.abs(s) < 350.0)
        wanted = float(np.min(-s.real[counts] / np.abs(s[counts]), initial=1.0))
        found, fast = damping(closed(late(a, b, 1.0), law.linear(q), c))
        assert found == pytest.approx(wanted, abs=1e-6)
        counts = (np.abs(s.imag) > 2.0) & (np.abs(s) >= 350.0)
        assert fast == pytest.approx(np.min(-s.real[counts] / np.abs(s[counts]), initial=1.0), abs=1e-6)


def test_a_delay_of_parts_of_a_sample_is_between_whole_ones(arms: dict[str, Arm]) -> None:
    """An input late by 1.5 samples: its effect over two held samples is that of the exact solution."""
    arm = arms[PLANAR]
    a, b = arm.linear(arm.home)
    u = np.array([1.0, -0.5])
    for delay in (0.0, 0.3, 1.0, 1.5, 2.0):
        f, g = late(a, b, delay)
        x = np.zeros(len(f))
        for _ in range(5):
            x = f @ x + g @ u

        def rate(t: float, x: np.ndarray, on: float = delay * PERIOD) -> np.ndarray:
            return a @ x + b @ u * (t >= on)

        options: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-14, "max_step": 2e-5}
        wanted = solve_ivp(rate, (0.0, 5.0 * PERIOD), np.zeros(len(a)), **options).y[:, -1]
        assert x[: len(a)] == pytest.approx(wanted, rel=1e-2, abs=1e-3 * np.abs(wanted).max())


def test_margins_are_edges_of_stability(arms: dict[str, Arm]) -> None:
    arm, c = arms[PLANAR], outputs(2)
    q = poses(arm, 1, 2)[0]
    law = DifferenceLaw(arm, True, 2.5).linear(q)
    loop, (a, b) = judged(arm, q, law, True), arm.linear(q)
    assert loop.stable
    assert 0.5 < loop.delay < 8.0

    def largest(delay: float, gain: float = 1.0) -> float:
        return float(np.abs(np.linalg.eigvals(closed(late(a, b, delay), law, c, gain))).max())

    assert largest(1.0 + loop.delay) < 1.0 < largest(1.0 + loop.delay + 0.2)
    assert largest(1.0, loop.gain) < 1.0 < max(largest(1.0, 1.1 * loop.gain), largest(1.0, 0.9 / loop.gain))


@pytest.mark.parametrize(("name", "share"), [(PLANAR, 2.5), (SCARA, 0.15), (SCARA, 2.5)])
def test_the_smallest_margins_are_those_of_all_poses(arms: dict[str, Arm], name: str, share: float) -> None:
    """The search at a pose ends where the margin is beyond those of the poses before; the least is the same."""
    arm, law = arms[name], DifferenceLaw(arms[name], True, share)
    found = the_rows.judged_at(arm, law, True, 12, 3)
    loops = [judged(arm, q, law.linear(q), True) for q in poses(arm, 12, 3)]
    assert found["stable"] == sum(loop.stable for loop in loops)
    for field in ("damping", "fast", *MARGINS):
        values = [getattr(loop, field) for loop in loops]
        if np.all(np.isfinite(values)):
            assert found[field] == pytest.approx(min(values), rel=1e-5)
        else:
            assert found[field] is None


def test_gains_with_the_full_inertia_are_those_of_the_commanded_pose(arms: dict[str, Arm]) -> None:
    arm = arms[SCARA]
    law = DifferenceLaw(arm, True, 0.3, matrix=True, integral=True)
    one, other = poses(arm, 2, 4)
    for q in (one, one, other, one):
        wanted = DifferenceLaw(arm, True, 0.3, matrix=True, integral=True).gains(q)
        assert all(np.array_equal(mine, its) for mine, its in zip(law.gains(q), wanted))
    assert not np.array_equal(law.gains(one)[0], law.gains(other)[0])


@pytest.mark.oracle
def test_the_rate_of_the_torque_is_fed_back(arms: dict[str, Arm]) -> None:
    """A twist that grows evenly asks for 2 ζ_v ω_v J times its rate, where the vibration is slow enough."""
    arm, rng = arms[SCARA], np.random.default_rng(1)
    theta, held = arm.rest(arm.home)
    rest = np.concatenate([arm.home, 0.0 * arm.home, theta, 0.0 * arm.home])
    reference, seen = Reference(rest, held, rest), np.concatenate([arm.home, theta])
    speed = 1e-6 * rng.standard_normal(arm.n)  # of the links; the motors stand
    laws = [
        DifferenceLaw(arm, True, 0.3, matrix=True, integral=True, turning=turning) for turning in (0.0, 0.42)
    ]
    for law in laws:
        law.start(arm.home)
    for k in range(60):
        y = seen + PERIOD * k * np.concatenate([speed, 0.0 * speed])
        without, fed = (law.step(y, reference) for law in laws)
    turns = np.sqrt(arm.stiffness * (1.0 / np.diag(arm.inertia_matrix(arm.home)) + 1.0 / arm.rotor))
    assert np.array_equal(turns < 400.0, [True, True, False, False])
    wanted = np.where(turns < 400.0, 2.0 * 0.42 * turns * arm.rotor * speed / arm.per_input, 0.0)
    assert fed - without == pytest.approx(wanted, rel=1e-6, abs=1e-15)


def test_the_rate_of_the_torque_damps_the_vibration(arms: dict[str, Arm]) -> None:
    arm = arms[PLANAR]
    without, fed = (
        judged(
            arm, arm.home, DifferenceLaw(arm, True, 0.45, matrix=True, turning=turning).linear(arm.home), True
        )
        for turning in (0.0, 0.42)
    )
    assert fed.damping > 2.0 * without.damping


@pytest.mark.oracle
def test_flatness_places_its_poles(arms: dict[str, Arm]) -> None:
    """Without damping of the springs, the continuous robot has them; the vibrations of the joints stay, damped."""
    arm = replace(arms[PLANAR], spring_damping=np.zeros(2))
    q = poses(arm, 1, 4)[0]
    a, b = arm.linear(q)
    turns = np.sqrt(arm.stiffness * (1.0 / np.diag(arm.inertia_matrix(q)) + 1.0 / arm.rotor))
    for left in (False, True):
        law = FlatnessLaw(arm, True, 0.5, left=left)
        k, i = law.gains(q)
        whole = np.block([[a - b @ k, -b], [i, np.zeros((2, 8))]])
        slow = np.repeat(law.w, 3 if left else 5).astype(complex)
        fast = (
            [turn * (-0.5 + sign * np.sqrt(0.75) * 1j) for turn in turns for sign in (1, -1)] if left else []
        )
        wanted = np.poly(np.concatenate([-slow, fast]))
        assert np.poly(np.linalg.eigvals(whole)) == pytest.approx(wanted.real, rel=1e-5)


@pytest.mark.oracle
def test_the_gains_of_lqg_minimise_its_cost(arms: dict[str, Arm], control: Any) -> None:
    """Riccati's recursion over many samples, with the cost of the docstring written as a sum over joints."""
    arm, w, velocity = arms[PLANAR], 40.0, 3.0
    law, q, n = LAWS["lqg"].make(arm, True, w=w, velocity=velocity), poses(arm, 1, 4)[0], 2
    plant, m = (
        control.sample_system(control.ss(*arm.linear(q), np.eye(8), 0.0), PERIOD, "zoh"),
        arm.inertia_matrix(q),
    )
    f, g = np.eye(10), np.vstack([plant.B, np.zeros((2, 2))])
    f[:8, :8], f[8:, :2] = plant.A, PERIOD * np.eye(2)
    cost = np.zeros((10, 10))
    for joint, rotor in enumerate(arm.rotor):
        inertia = np.array([m[joint, k] + rotor * (k == joint) for k in range(n)])
        for first, weight in ((0, w**2), (2, velocity * w), (8, 0.5 * w**3)):
            row = np.zeros(10)
            row[first : first + 2] = weight * inertia / (arm.per_input[joint] * arm.limit[joint])
            cost += np.outer(row, row)
    spent, p = np.diag(1.0 / arm.limit**2), cost.copy()
    for _ in range(5000):
        gain = np.linalg.solve(spent + g.T @ p @ g, g.T @ p @ f)
        p = cost + f.T @ p @ (f - g @ gain)
        p = 0.5 * (p + p.T)
    mine = np.hstack(law.gains(q))  # type: ignore[attr-defined]
    assert mine == pytest.approx(gain, rel=1e-3, abs=1e-4 * np.abs(gain).max())


# Metrics ------------------------------------------------------------------------------------------
def still(start: np.ndarray, goal: np.ndarray, count: int = 1500) -> Move:
    n = len(goal)
    line = np.clip(np.arange(count) / 500.0, 0.0, 1.0)[:, None]
    states = np.hstack([start + line * (goal - start), np.zeros((count, 3 * n))])
    return Move(start, goal, states, np.zeros((count, n)))


def test_metrics_of_known_runs() -> None:
    move = still(np.zeros(3), np.array([1.0, -0.5, 0.1]))
    slides, limit, span = (
        np.array([False, False, True]),
        np.array([10.0, 5.0, 2.0]),
        np.array([6.0, 4.0, 0.2]),
    )
    q, u = move.states[:, :3].copy(), np.zeros((1500, 3))
    whole = metrics(move, q, u, limit, slides, span)
    assert whole.arrives
    assert (whole.remaining, whole.wrong_way, whole.path, whole.ripple, whole.saturation) == (0, 0, 0, 0, 0)
    q[100:120, 1] = 0.02  # 4 % of its travel to the other side
    q[100:120, 2] = -0.002  # 2 %
    q[-TAIL, 0] += 0.8e-3
    u[:, 2] = np.where(np.arange(1500) % 2, 0.02, -0.02)
    u[:150, 1] = 5.0
    found = metrics(move, q, u, limit, slides, span)
    assert found.wrong_way == pytest.approx(4.0)
    assert found.remaining == pytest.approx(0.8e-3)
    assert found.arrives
    assert found.ripple == pytest.approx(1.0)
    assert found.saturation == pytest.approx(10.0)
    assert found.path == pytest.approx(0.02 + 0.5 * 119 / 500)
    q[-1, 0] += 1.1e-3
    assert not metrics(move, q, u, limit, slides, span).arrives
    lost = metrics(move, q[:700], u[:700], limit, slides, span)
    assert lost.lost
    assert summary([found, lost])["remaining_worst"] is None
    assert summary([found, lost])["arrived"] == 1
    assert summary([found, lost])["saturation"] == pytest.approx(300 / 22, rel=1e-5)


def test_small_travels_count_as_a_twentieth_of_the_largest_and_resting_joints_apart() -> None:
    slides, limit, span = np.zeros(3, dtype=bool), np.ones(3), np.full(3, 6.0)
    move = still(np.zeros(3), np.array([1.0, 0.01, 0.0]))
    q = move.states[:, :3].copy()
    q[50, 1], q[60, 2] = -0.005, 0.03
    found = metrics(move, q, np.zeros((1500, 3)), limit, slides, span)
    assert found.wrong_way == pytest.approx(10.0)  # 0.005 of 0.05
    assert found.excursion == pytest.approx(3.0)


def test_travels_of_joints_that_turn_and_slide_are_compared_by_their_share_of_the_range() -> None:
    slides, limit, span = np.array([False, True]), np.ones(2), np.array([6.0, 0.2])
    move = still(np.zeros(2), np.array([3.0, 0.001]))  # half of the range, which is 0.1 m of the other
    q = move.states[:, :2].copy()
    q[50, 1] = -0.0005
    assert metrics(move, q, np.zeros((1500, 2)), limit, slides, span).wrong_way == pytest.approx(10.0)
    move = still(np.zeros(2), np.array([3.0, 0.0]))
    q = move.states[:, :2].copy()
    q[50, 1] = 0.001
    assert metrics(move, q, np.zeros((1500, 2)), limit, slides, span).excursion == pytest.approx(1.0)


def test_a_push_is_measured_from_where_it_begins() -> None:
    move = still(np.zeros(1), np.ones(1))
    q = move.states[:, :1].copy()
    time = PERIOD * np.arange(PUSHED)
    q[-PUSHED:, 0] += 0.1 * np.exp(-time / 0.05)
    found = metrics(move, q, np.zeros((1500, 1)), np.ones(1), np.array([False]), np.ones(1), pushed=True)
    assert found.peak == pytest.approx(0.1)
    assert found.back == pytest.approx(0.05 * np.log(5.0), abs=1e-3)  # 2 % of one
    assert found.remaining == pytest.approx(0.1 * np.exp(-0.45 / 0.05))


# Runs ---------------------------------------------------------------------------------------------
def test_latency_is_a_queue_of_inputs(arms: dict[str, Arm]) -> None:
    arm = arms[PLANAR]
    given: list[np.ndarray] = []

    class Counting:
        """Its input is the number of the step."""

        def start(self, q: np.ndarray) -> None:
            self.k = 0.0

        def step(self, y: np.ndarray, reference: Reference) -> np.ndarray:
            assert len(y) == 2  # motors alone
            self.k += 1e-3
            return np.full(2, self.k)

        def linear(self, q: np.ndarray) -> Any:
            raise NotImplementedError

    class Watched(RungeKutta):
        def advance(self, u: np.ndarray, push: np.ndarray | None = None) -> None:
            given.append(u)
            super().advance(u, push)

    condition = Condition("test", links=False, latency=2)
    trip(Watched, Counting(), [arm], [short(arm)], condition)
    held = arm.rest(arm.home)[1]
    assert np.array_equal(given[0], held)
    assert np.array_equal(given[1], held)
    assert [u[0] for u in given[2:5]] == pytest.approx([1e-3, 2e-3, 3e-3])


def test_a_robot_that_is_lost_begins_again_at_its_goal(arms: dict[str, Arm]) -> None:
    arm = arms[PLANAR]
    good = DifferenceLaw(arm, True, 2.5)

    class Wild:
        """Full input in the first move, then the other law."""

        begun = 0

        def start(self, q: np.ndarray) -> None:
            self.begun += 1
            good.start(q)

        def step(self, y: np.ndarray, reference: Reference) -> np.ndarray:
            return np.array([-24.0, 24.0]) if self.begun == 1 else good.step(y, reference)

        def linear(self, q: np.ndarray) -> Any:
            raise NotImplementedError

    goal = arm.home + 0.01
    long = moves(arm, np.array([[2.5, -2.0], goal]))
    way = [long[0], moves(arm, np.array([goal]))[0]]
    way[1] = replace(way[1], start=way[1].start)
    law = Wild()
    found = trip(PLANTS["mujoco"], law, [arm], way, Condition("test"))
    assert [one.lost for one in found.moves] == [True, False]
    assert law.begun == 2
    assert found.moves[1].remaining < 5e-3


def test_a_law_begins_at_rest_and_takes_a_jump_of_the_command_without_a_blow(arms: dict[str, Arm]) -> None:
    """The first input of PD is proportional; a filter that begins at rest sees nothing new."""
    arm = arms[PLANAR]
    move = steps(arm, arm.home[None])[0]
    theta, held = arm.rest(move.start)
    y, reference = np.concatenate([move.start, theta]), move.reference(0)
    pd, flat = DifferenceLaw(arm, True, 1.0), FlatnessLaw(arm, True, 1.0)
    pd.start(move.start)
    wanted = reference.input - pd.gains(move.goal)[0] @ (theta - arm.rest(move.goal)[0])
    assert pd.step(y, reference) == pytest.approx(wanted)
    flat.start(move.start)
    flat.step(y, reference)
    f, g, _ = flat.model(move.goal)
    away = np.concatenate([move.start, np.zeros(2), theta, np.zeros(2)]) - reference.state
    assert flat.error == pytest.approx(f @ away + g @ (held - reference.input))


def test_shares_rise() -> None:
    assert list(SHARES) == sorted(set(SHARES))


@pytest.mark.ci("designs a law at a pose")
def test_the_linear_loop_of_the_law_of_one_pose_is_flexhinfs(tmp_path: Path) -> None:
    """Eigenvalues of the loop at another pose, with the spring's damping and a sample of latency."""
    arm, links = Arm.of(ROBOTS[PLANAR].robot()), ("link_position", "motor_position")
    LAWS["one-pose"].make(arm, True, tmp_path)
    law: Any = LAWS["one-pose"].make(arm, True, tmp_path)  # the saved one
    q = poses(arm, 1, 6)[0]
    mine = np.abs(np.linalg.eigvals(closed(late(*arm.linear(q), 1.0), law.linear(q), outputs(2))))
    loop = EquilibriumLoop(
        law.controller.law, law.controller.estimator, arm.robot.plant(links, extras=("joint_damping",)), PERIOD,
        equilibrium=arm.robot.operating_point(q), moving=True, latency=1,
    ).linear()  # fmt: skip
    theirs = np.abs(loop.closed_loop.multipliers)
    assert np.sort(mine)[::-1][:10] == pytest.approx(np.sort(theirs)[::-1][:10], abs=1e-7)
    run = trip(PLANTS["mujoco"], law, [arm], [short(arm)], Condition("test"))
    assert run.refused == 0
    assert run.moves[0].remaining < 5e-3
