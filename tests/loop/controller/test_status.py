"""What a controller says of itself: against loops written out with the whole history, on robots that swing and rest."""

from __future__ import annotations

import copy
import math
import pickle
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tests.loop.conftest import LinearLaw, arm_law, arm_ukf, two_inputs
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.status import _counted

# Kernels that run once each: 3 s instead of 6 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

EVERY = {"workspace": "hold", "limit_cycle": "hold", "saturation": "brake"}


def supervised(law: fh.Law, estimator: fh.Estimator | None = None, **options: object) -> fh.Controller:
    rest = {name: options.pop(name) for name in ("saturation", "moving", "latency") if name in options}
    return fh.Controller(law, estimator, 1e-3, supervision=fh.Supervision(**options), **rest)  # type: ignore[arg-type]


def pair(**options: object) -> fh.Controller:
    """Two inputs of ±2 and one command, fed back the true state."""
    law = two_inputs()[1]
    return supervised(law, saturation=2.0, **options)


def told(
    u: np.ndarray, r: np.ndarray, swing: float, most: float, longest: float, lasting: float
) -> list[int]:
    """Bits of limit cycle and saturation of one input of ±2, from the whole history."""
    bits, ends, extreme, up, begun, stuck = [], [], 0.0, True, 0, 0
    for k, value in enumerate(u):
        extreme = max(extreme, value) if up else min(extreme, value)
        if (extreme - value if up else value - extreme) > swing:
            ends, extreme, up = [*ends, k], value, not up
        if k == 0 or r[k] != r[k - 1] or (k - max([end for end in ends if end <= k], default=-1) > longest):
            begun = k + 1
        stuck = stuck + 1 if abs(value) >= 1.998 else 0
        bits.append(2 * (sum(end >= begun for end in ends) >= most) + 4 * (stuck > lasting))
    return bits


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(6))
def test_counters_are_those_of_the_whole_history(seed: int) -> None:
    """The first input follows a − x, so that any input can be made by the state that is fed back."""
    rng = np.random.default_rng(seed)
    law = LinearLaw(("a", "b"), ("u", "v"), [[1.0, 0.0], [0.0, 0.0]])
    controller = supervised(
        law, saturation=2.0, swing=0.3, damping=0.4, longest_swing=0.02, saturation_time=0.03
    )
    most = 1 + math.ceil(math.log(4.0 / 0.3) / (math.pi * 0.4 / math.sqrt(1 - 0.16)))
    steps = rng.normal(0.0, rng.choice([0.02, 0.2, 1.0], 2000))
    wave = np.cumsum(steps * (rng.random(2000) < 0.3))
    wave = 3.0 * np.sin(wave) + 2.5 * np.sin(np.arange(2000) * rng.uniform(0.1, 0.5)) * (
        np.arange(2000) // 300 % 2
    )
    u = np.clip(wave, -2.0, 2.0)
    expected = told(u, np.zeros(2000), 0.3, most, 20.0, 30.0)
    bits = []
    for value in wave:
        assert controller.step([value, 0.0])[0] == pytest.approx(min(max(value, -2.0), 2.0), abs=1e-12)
        bits.append(int(controller.status))
    assert bits == expected
    assert {0, 2} <= set(bits)


def test_the_first_sample_of_a_new_command_ends_a_limit_cycle_and_leaving_the_box_shows_at_once() -> None:
    controller = pair(workspace=(-1.0, 0.5), swing=0.1, damping=0.5)
    for k in range(60):
        controller.step([0.0, 0.0, 0.2 * (-1) ** k, 0.0], 0.25)
    assert controller.status == fh.Status.LIMIT_CYCLE
    controller.step([0.0, 0.0, 0.2, 0.0], 0.500001)
    assert controller.status == fh.Status.OUTSIDE_WORKSPACE
    controller.step([0.0, 0.0, 0.2, 0.0], 0.5)
    assert controller.status == fh.Status(0)
    with pytest.raises(fh.NumericalFailure):  # a sample that is refused says nothing new
        controller.step([0.0, 0.0, 0.0, 0.0], np.nan)
    assert controller.status == fh.Status(0)


def test_what_is_watched_changes_no_input_and_belongs_to_copies_and_files(tmp_path: Path) -> None:
    plain, watched = (fh.Controller(arm_law(), arm_ukf(), 1e-3, 0.5, latency=1, **kind) for kind in (
        {}, {"supervision": fh.Supervision(workspace=(-0.1, 0.1), swing=0.02, damping=0.7)},
    ))  # fmt: skip
    rng = np.random.default_rng(3)
    seen = set()
    for k in range(400):
        y, r = 0.05 * rng.standard_normal(1), 0.2 * (k // 100 % 2)
        assert np.array_equal(plain.step(y, r), watched.step(y, r))
        seen.add(int(watched.status))
    assert {0, 1} < seen
    assert plain.status == fh.Status(0)
    assert plain.path_rate == 1.0
    watched.save(tmp_path / "arm")
    loaded = fh.load_controller(tmp_path / "arm")
    assert loaded.supervision is not None
    assert watched.supervision is not None
    assert loaded.supervision.settings() == watched.supervision.settings()
    assert loaded.data_vector.tobytes() == watched.data_vector.tobytes()
    for other in (copy.deepcopy(watched), pickle.loads(pickle.dumps(watched))):
        assert other.status == watched.status
        assert np.array_equal(other.step(0.1, 0.3), copy.copy(watched).step(0.1, 0.3))
        assert other.status & fh.Status.OUTSIDE_WORKSPACE
    plain.save(tmp_path / "plain")
    assert fh.load_controller(tmp_path / "plain").supervision is None


# The incidents ------------------------------------------------------------------------------------------
def two_links() -> tuple[fh.Robot, fh.Law, fh.Plant]:
    """High gain on two links, fed back the true state at 1 kHz: stable, and not with one sample of latency."""
    robot = fh.load_robot("planar-two-link")
    penalty = fh.Penalty({"link_position": 100.0, "link_position_integral": 500.0}, effort=1e-6)
    return robot, fh.linear_law(robot.problem(penalty), gamma=math.inf), robot.plant()


@pytest.mark.parametrize("late", [0, 1])
def test_one_unknown_sample_of_latency_at_high_gain_is_noticed_within_a_third_of_a_second(
    late: int,
) -> None:
    robot, law, plant = two_links()
    controller = fh.Controller(
        law, None, 1e-3, 24.0, start="bumpless", supervision=fh.Supervision(workspace=(0.3, 0.7))
    )
    run = fh.Loop(plant, controller, delay=1e-3 * late).run(
        {"link_position_shoulder": 0.45, "link_position_elbow": 0.65}, duration=1.0,
        initial_state=robot.operating_point()[0],
    )  # fmt: skip
    said = []
    for x, r in zip(run.signals["state"], run.signals["reference"], strict=True):
        controller.step(x, r)
        said.append(bool(controller.status & fh.Status.LIMIT_CYCLE))
    swinging = np.ptp(run.signals["input"][-100:], axis=0).max()
    assert (swinging > 20.0) == bool(late)
    assert any(said[:333]) == bool(late)
    assert all(said[333:]) == bool(late)


@pytest.mark.parametrize("moving", [False, True])
def test_a_goal_outside_the_workspace_is_reported_by_the_step_that_hears_of_it(moving: bool) -> None:
    robot, law, _ = two_links()
    box = (np.array([-0.1, -0.2]), np.array([0.1, 0.2]))
    controller = supervised(law, saturation=24.0, moving=moving, workspace=box)
    x, u = robot.operating_point()
    for goal, outside in (
        ((0.1, 0.2), False),
        ((0.1001, 0.0), True),
        ((0.0, -0.2001), True),
        ((0.0, 0.0), False),
    ):
        there, holding = robot.operating_point(goal)
        controller.step(x, np.concatenate([there, holding]) if moving else goal)
        assert bool(controller.status & fh.Status.OUTSIDE_WORKSPACE) == outside
    assert u == pytest.approx(controller.law.operating_input)


@pytest.mark.ci("20,000 samples in Python")
@pytest.mark.oracle
@pytest.mark.parametrize(("damping", "alarm"), [(0.05, False), (0.049, False), (0.04, True), (0.0, True)])
def test_swings_that_settle_as_stated_are_no_limit_cycle(damping: float, alarm: bool) -> None:
    """A free oscillation from one limit, exp(−ζωt) cos(ω√(1 − ζ²) t): swings shrink by exp(−πζ/√(1 − ζ²)) each."""
    t = np.arange(0.0, 20.0, 1e-3)
    decay = np.exp(-damping * 12.0 * t)[:, None]
    u = 24.0 * decay * np.cos(12.0 * math.sqrt(1.0 - damping**2) * t[:, None])
    swings = fh.Supervision().data(SimpleNamespace(lower=np.array([-24.0]), upper=np.array([24.0])), 0, 1e-3)[
        "swings"
    ]
    assert swings[:, 0] == pytest.approx([0.024, 4.8, 16.0])
    assert (swings_at_rest(u, np.zeros(len(t)), 4.8, 1570.0)[0] >= 16) == alarm


# No false alarm -----------------------------------------------------------------------------------------
def swings_at_rest(u: np.ndarray, r: np.ndarray, swing: float, longest: float) -> np.ndarray:
    """Largest count of swings of each input (N, m), by the controller's own counters."""
    rows = [u[0], np.ones(u.shape[1]), *np.zeros((3, u.shape[1]))]
    most = np.zeros(u.shape[1])
    for k in range(1, len(u)):
        resting = float(np.array_equal(r[k], r[k - 1]))
        rows = _counted(resting, longest, u[k], -24.0, 24.0, 0.024, swing, 16.0, *rows)
        most = np.maximum(most, rows[2])
    return most


@pytest.mark.property
@pytest.mark.parametrize("count", [
    pytest.param(15, marks=pytest.mark.ci("15 random moves of two links")),
    pytest.param(200, marks=pytest.mark.nightly("200 moves, not 15")),
])  # fmt: skip
def test_random_moves_with_noise_and_dry_friction_raise_no_alarm(count: int) -> None:
    """Quintic moves at half the motors' speed within ±1.2 rad, 1e-4 rad of noise, then one second at rest."""
    robot = fh.load_robot("planar-two-link")
    sensors = ("link_position", "motor_position")
    law = fh.linear_law(robot.problem(measured=sensors), gamma=math.inf)
    true = robot.plant(sensors, extras=("coulomb_friction",), sticking=True)
    rng = np.random.default_rng(7)
    for seed in range(count):
        begin, end = rng.uniform(-1.2, 1.2, (2, 2))
        last = max(0.4, 1.875 * float(np.abs(end - begin).max()) / 2.0)
        move = fh.Moving([fh.Quintic(a, b, last, at=0.1) for a, b in zip(begin, end)], robot.inverse_dynamics)
        x, u = robot.operating_point(begin)
        ukf = fh.UnscentedKalmanFilter(robot.plant(sensors), 1e-3, [0, 0, 1e-7, 1e-7] * 2, 1e-8, x, 1e-6)
        controller = fh.Controller(
            law,
            ukf,
            1e-3,
            24.0,
            moving=True,
            latency=1,
            supervision=fh.Supervision(workspace=(-1.2, 1.2), position_swing=2e-3, following=0.2),
        )
        duration = round(last + 1.1, 3)
        run = fh.Loop(true, controller).run(
            move, noise=1e-4, duration=duration, initial_state=x, initial_input=u, seed=seed
        )
        states, inputs = run.signals["state"], run.signals["input"]
        assert np.abs(states[-1, :2] - end).max() < 0.02
        references = move((np.arange(len(inputs)) + 1) * 1e-3)
        assert swings_at_rest(inputs, references, 4.8, 1570.0).max() < 4
        assert np.abs(inputs).max() < 23.9
        if seed < 5:  # the step itself, sample by sample
            for y, r in zip(run.signals["output"], references, strict=True):
                controller.step(y, r)
                assert controller.status == fh.Status(0)


# Reactions ----------------------------------------------------------------------------------------------
def test_hold_keeps_the_last_command_inside_and_limit_the_nearest() -> None:
    """The inputs are those of a controller that is given these commands."""
    law = two_inputs()[1]
    box = {"workspace": (-0.5, 0.5)}
    for reaction, heard in (("hold", [0.1, 0.3, 0.3, 0.3, 0.4]), ("limit", [0.1, 0.3, 0.5, -0.5, 0.4])):
        plain = fh.Controller(law, None, 1e-3, 2.0)
        controller = pair(**box, reactions={"workspace": reaction})
        said = []
        for r, own in zip([0.1, 0.3, 0.9, -0.7, 0.4], heard):
            for k in range(5):
                x = [0.01 * k, 0.0, 0.02, 0.0]
                assert np.array_equal(controller.step(x, r), plain.step(x, own))
            said.append(int(controller.status))
        assert said == [0, 0, 9, 9, 0]


def test_hold_at_the_first_sample_keeps_the_position() -> None:
    plain, controller = pair(), pair(workspace=(-0.5, 0.5), reactions={"workspace": "hold"})
    for _ in range(4):
        assert np.array_equal(
            controller.step([0.2, 0.0, 0.0, 0.0], 3.0), plain.step([0.2, 0.0, 0.0, 0.0], 0.2)
        )


@pytest.mark.parametrize("event", ["saturation", "limit_cycle"])
def test_an_event_freezes_the_command_where_the_joint_is_until_a_reset(event: str) -> None:
    law = two_inputs()[1]
    quick = {"swing": 0.1, "damping": 0.5, "saturation_time": 0.02}
    plain, controller = fh.Controller(law, None, 1e-3, 2.0), pair(**quick, reactions={event: "hold"})
    bit = fh.Status.SATURATION if event == "saturation" else fh.Status.LIMIT_CYCLE
    frozen = None
    for k in range(120):
        x = [0.1 + 1e-3 * k, 0.0, 9.0 if event == "saturation" else 0.3 * (-1) ** k, 0.0]
        if frozen is None and controller.status & bit:
            frozen = x[0]
        u = controller.step(x, 0.5 if k < 100 else -0.5)
        assert np.array_equal(u, plain.step(x, (0.5 if k < 100 else -0.5) if frozen is None else frozen))
    assert frozen is not None
    assert controller.status & fh.Status.REACTING
    controller.reset()
    plain.reset()
    assert np.array_equal(controller.step([0.0] * 4, 0.5), plain.step([0.0] * 4, 0.5))
    assert controller.status == fh.Status(0)


@pytest.mark.ci("compiles a loop; a controller that brakes is quick")
@pytest.mark.parametrize("plant", ["equations", "mujoco"])
@pytest.mark.parametrize("by_name", [False, True])
def test_a_loop_brakes_its_command_as_the_signal_that_is_braked(plant: str, by_name: bool) -> None:
    """From the first command outside on; one that begins outside of the box may come back, and leave it later."""
    arm = fh.paper_arm()
    controller = supervised(
        arm_law(), arm_ukf(), workspace=(-0.1, 0.1), reactions={"workspace": "brake"}, braking_time=0.2
    )
    true = arm.plant()
    if plant == "mujoco":
        pytest.importorskip("mujoco")
        true = fh.robot.MuJoCoPlant(arm)
    time = 1e-3 * np.arange(801)
    for signal, crossing in ((fh.Sine(0.3, 0.5), 0), (fh.Sine(0.3, 0.5, phase=2.5), 1)):
        outside = np.abs(signal(time)) > 0.1
        left = np.flatnonzero(outside[1:] & ~outside[:-1])[0] + 1
        assert outside[0] == bool(crossing)
        reference = {"link_position": signal} if by_name else signal
        run = fh.Loop(true, controller).run(reference, duration=0.8)
        expected = fh.Braked(signal, at=time[left], time=0.2)(time)
        assert run.signals["reference"][:, 0] == pytest.approx(expected, abs=1e-12)


def test_braking_slows_the_path_and_the_signal_that_is_braked_stops_where_it_says() -> None:
    """The caller's own clock, advanced by the path rate, ends within a period of `Braked`."""
    controller = supervised(
        two_links()[1], saturation=24.0, moving=True, workspace=(-0.3, 0.3), reactions={"workspace": "brake"},
        braking_time=0.2,
    )  # fmt: skip
    robot, signal = two_links()[0], fh.Sine(0.5, 0.5)
    clock, begun, rates, clocks = 0.0, None, [], []
    for _ in range(700):
        q, dq = signal.derivatives(clock, 1)
        x, u = robot.inverse_dynamics([q, 0.0], [dq * controller.path_rate, 0.0])
        controller.step(x, np.concatenate([x, u]))
        if begun is None and q > 0.3:
            begun = clock
            assert controller.status & fh.Status.OUTSIDE_WORKSPACE
        clocks.append(clock)
        clock += 1e-3 * controller.path_rate
        rates.append(controller.path_rate)
    assert begun is not None
    assert controller.status & fh.Status.REACTING
    assert rates[0] == 1.0
    assert rates[-1] == pytest.approx(0.0, abs=1e-14)
    assert np.all(np.diff(rates) <= 1e-15)
    braked = fh.Braked(signal, at=begun, time=0.2)
    assert clock == pytest.approx(begun + 0.1, abs=1e-3)
    assert braked(np.arange(700) * 1e-3) == pytest.approx(signal(np.array(clocks)), abs=1.6e-3)
    controller.reset()
    assert controller.path_rate == 1.0


@pytest.mark.parametrize(
    ("options", "anchors"),
    [
        ({"workspace": (1.0, 0.0)}, ["workspace", "lower < upper"]),
        ({"workspace": (0.0, [1.0, 2.0, 3.0])}, ["workspace", 1]),
        ({"workspace": (np.nan, 1.0)}, ["workspace"]),
        ({"workspace": 1.0}, ["workspace", "(lower, upper)"]),
        ({"reactions": "hold"}, ["reactions"]),
        ({"swing": 0.0}, ["swing"]),
        ({"swing": [1.0, 2.0, 3.0]}, ["swing", 2]),
        ({"damping": 1.0}, ["damping", 1]),
        ({"longest_swing": 0.0}, ["longest_swing"]),
        ({"saturation_time": -1.0}, ["saturation_time"]),
        ({"braking_time": np.inf}, ["braking_time"]),
        ({"reactions": {"noise": "hold"}}, ["noise", "saturation"]),
        ({"reactions": {"limit_cycle": "brake"}}, ["limit_cycle", "hold"]),
        ({"reactions": {"workspace": "hold"}}, ["workspace", "hold"]),
        ({"reactions": {"following": "hold"}}, ["following", "hold"]),
        ({"following": -0.1}, ["following"]),
        ({"position_swing": [1.0, 2.0]}, ["position_swing", 1]),
        ({"moving": True, "workspace": (0.0, 1.0), "reactions": {"workspace": "hold"}}, ["moving", "brake"]),
    ],
)
def test_what_does_not_fit_is_refused(options: dict[str, object], anchors: list[str]) -> None:
    with refused_with(InvalidInput, *anchors):
        pair(**options)


def test_a_box_that_is_open_on_one_side_says_its_other_end() -> None:
    box = fh.Supervision(([-1.0, -1.0, -1e-9], [2.0, np.inf, 1.0])).box_text(["rad", "m", "rad"])
    assert box.split(", ") == ["−1 to 2 rad", "−1 to ∞ m", "0 to 1 rad"]


def test_what_nothing_is_commanded_has_no_workspace() -> None:
    law = LinearLaw(("a", "b"), ("u",), [[1.0, 0.0]])
    with refused_with(InvalidInput, "workspace", "None"):
        supervised(law, workspace=(-1.0, 1.0))
    with refused_with(InvalidInput, "supervision", "Supervision"):
        fh.Controller(law, None, 1e-3, supervision={"swing": 1.0})  # type: ignore[arg-type]


# Other forms of the step --------------------------------------------------------------------------------
@pytest.mark.ci("150 steps in NumPy and in CasADi")
@pytest.mark.parametrize("pieces", [False, True])
def test_numbers_traced_functions_and_kernels_step_alike(pieces: bool) -> None:
    """The memory after each sample, by NumPy on numbers, by one CasADi function, and by the compiled kernel."""
    controller = fh.Controller(
        arm_law(), arm_ukf(), 1e-3, 0.5, latency=1, offset_time=0.1,
        supervision=fh.Supervision(
            (-0.02, 0.02), swing=0.05, damping=0.5, saturation_time=0.01, position_swing=0.03, following=0.15,
            reactions=EVERY | {"following": "hold"},
        ),
    )  # fmt: skip
    controller = controller.in_pieces() if pieces else controller
    rng, seen = np.random.default_rng(1), 0
    plain = traced = controller.initial_memory()
    layout, data = controller.memory, controller.data.named(controller.data_vector)
    for k in range(150):
        y = 0.02 * rng.standard_normal(1) + 0.2 * (100 < k < 135)
        r = np.array([0.03 * (-1) ** (k // 40)])
        u, _, after = controller._stepped(y, r, layout.named(plain), data)
        traced_u, traced = controller.evaluate(y, r, traced)
        plain, own = layout.flat(after), controller.step(y, r)
        assert np.asarray(u, dtype=float) == pytest.approx(own, abs=1e-7)
        assert traced_u == pytest.approx(own, abs=1e-7)
        for place in (layout.places["status"], layout.places["stop"]):
            assert np.array_equal(plain[place], traced[place])
        assert int(controller.status) == plain[layout.places["status"]] @ [1, 2, 4, 8, 32, 64]
        seen |= int(controller.status)
    assert seen == 47


@pytest.mark.ci("a kernel of an ensemble")
def test_many_robots_at_once_react_as_one_does() -> None:
    law, plant = arm_law(), fh.paper_arm().plant()
    controller = supervised(
        law, arm_ukf(), saturation=2.0, workspace=(-0.05, 0.05), reactions={"workspace": "limit"}
    )
    loop = fh.Loop(plant, controller)
    one = loop.run(0.3, duration=1.5)
    assert one.signals["state"][-1, 0] == pytest.approx(0.05, abs=0.02)
    many = loop.ensemble(0.3, duration=1.5, kept=("state.link_position",), instants=[1500])
    values = many.run([{}] * 5, range(5)).kept
    assert np.ravel(values) == pytest.approx(np.full(5, one.signals["state"][-1, 0]), abs=1e-9)
