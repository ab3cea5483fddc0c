"""The controller for a workspace as it runs on a robot: what it watches, where it starts, its noise, and as C."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.designs.deployed_run import prepare_run
from flexhinf.designs.plans import BEYOND
from flexhinf.designs.specification import SpecificationError
from flexhinf.designs.workspace.evidence import LoopOverWorkspace
from flexhinf.designs.workspace.resting_loops import ACCELERATION, OFFSET, OFFSET_TIME
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.export.recording import record
from flexhinf.modal import ModalLaw
from flexhinf.modal.pair import PairWeights
from flexhinf.robot import MuJoCoPlant, Robot
from flexhinf.robot.workspace import workspace_of

BOTH = ("link_position", "motor_position")
AWAY = (-0.9, 1.1)

#: An encoder on the link of the heavy joint alone: the common retrofit.
UNLIKE = ("motor_position", "link_position_shoulder")

#: Variances of the SCARA's encoders, 10 µrad and 1 µm, and of torque sensors, a thousandth of each motor's limit.
PRECISE = (1e-10, 1e-10, 1e-12, 1e-10, 0.15**2, 0.06**2, 0.25**2, 0.006**2)


@cache
def arm(name: str = "planar-two-link") -> Robot:
    return fh.load_robot(name)


@cache
def made(name: str = "planar-two-link", bandwidth: float = 15.0, **fields: Any) -> WorkspaceSetup:
    """The loop with a law of this bandwidth, which no search has chosen."""
    s = fh.Specification(**{"workspace": "limits", "measured": BOTH, "peak_speed": 3.0, **fields})
    space = workspace_of(arm(name), s.workspace)
    problem = arm(name).problem(fh.Penalty({"link_position": 1.0}))
    law = ModalLaw.tuned(problem, s.period, PairWeights(bandwidth=bandwidth, share=0.7), space.sample(100, 3))
    return WorkspaceSetup(arm(name), s, space, law)


def deployed(setup: WorkspaceSetup, at: Any = None, **options: Any) -> fh.Controller:
    return LoopOverWorkspace(setup).controller(at, **options)


def reference(pose: Any, name: str = "planar-two-link") -> np.ndarray:
    return np.concatenate(arm(name).operating_point(pose))


def resting(pose: Any) -> np.ndarray:
    """What both encoders of the planar arm measure at rest at a pose."""
    return arm().operating_point(pose)[0][[0, 1, 4, 5]]


def noisy(y: np.ndarray, noise: np.random.Generator) -> np.ndarray:
    """What encoders say there: a frame that is equal to the last one, bit by bit, is taken for a repeated one."""
    return y + 1e-5 * noise.normal(size=len(y))


@pytest.fixture(scope="module")
def braking(tmp_path_factory: pytest.TempPathFactory) -> Callable[[], tuple[fh.Controller, Any]]:
    """A controller that comes to rest within 20 ms of leaving its box, in Python and as the same compiled C."""
    setup, _, _ = leaving()
    watch = replace(setup.supervision, reactions={"workspace": "brake"}, braking_time=0.02, following=None)
    library: list[Any] = []

    def fresh() -> tuple[fh.Controller, Any]:
        one = deployed(setup, AWAY, supervision=watch)
        if not library:
            file = tmp_path_factory.mktemp("braking") / "arm.so"
            library.append(fh.load_compiled(fh.compile_controller(one, file)))
        library[0].reset()
        return one, library[0]

    return fresh


# What it watches ----------------------------------------------------------------------------------------
@pytest.mark.costs("the law and the setup of all tests here")
def test_it_watches_the_box_of_its_workspace(tmp_path: Path) -> None:
    """The joint ranges, a box, the box of poses with room for splines; of a box in space the joint ranges."""
    poses = [[-0.5, 0.2], [0.5, 1.0], [0.1, -0.4]]
    table = {"time": [0.0, 1.0, 2.0], "shoulder": [p[0] for p in poses], "elbow": [p[1] for p in poses]}
    spaces = {
        "limits": ([-3.0, -2.6], [3.0, 2.6]), "-1:1,-0.5:1.2": ([-1.0, -0.5], [1.0, 1.2]),
        "x=0.2:0.9": ([-3.0, -2.6], [3.0, 2.6]),
    }  # fmt: skip
    for text, box in spaces.items():
        watch = replace(made(), workspace=workspace_of(arm(), text)).supervision
        assert np.array(watch.workspace) == pytest.approx(np.array(box), abs=1e-5)
        assert watch.modes(True, made().governor) == ("brake", "none", "none", "brake", "brake")
    along = replace(made(), workspace=workspace_of(arm(), table)).supervision
    spans = BEYOND * np.ptp(poses, axis=0)
    assert np.array(along.workspace) == pytest.approx(
        np.array([np.min(poses, axis=0) - spans, np.max(poses, axis=0) + spans])
    )

    deployed(made(), AWAY).save(tmp_path / "controller")
    controller = fh.load_controller(tmp_path / "controller")
    controller.step(resting((3.0, -2.6)), reference((3.0, -2.6)))
    assert not controller.status & fh.Status.OUTSIDE_WORKSPACE
    outside = reference((3.0, -2.6)) + np.eye(10)[0] * 1e-4
    controller.step(resting((3.0, -2.6)), outside)
    assert fh.Status.OUTSIDE_WORKSPACE | fh.Status.REACTING in controller.status
    assert controller.path_rate < 1.0


@pytest.mark.ci("C of a controller is compiled")
def test_a_stated_reaction_brakes_along_the_path_also_in_c(
    needs_compiler: Callable[..., None], braking: Callable[[], Any]
) -> None:
    """On MuJoCo's robot: its protection knows that an arm which stands still there is none."""
    needs_compiler("cc")
    (one, library), rates, u = braking(), [], arm().operating_point(AWAY)[1]
    box, noise = MuJoCoPlant(arm(), measured=BOTH), np.random.default_rng(1)
    box.reset(arm().operating_point(AWAY)[0])
    for k in range(60):
        r = reference(AWAY) + np.eye(10)[1] * (2.0 if k == 20 else 0.0)
        y = noisy(box.output(), noise)
        box.step(u, (), 1e-3)  # the input of the sample before, as of a latency of one sample
        u = one.step(y, r)
        np.testing.assert_array_equal(library.step(y, r), u)
        assert (library.code, library.status, library.path_rate) == (one.code, one.status, one.path_rate)
        assert library.may_act()
        assert one.may_act()
        np.testing.assert_array_equal(library.output, one.output)
        rates.append(one.path_rate)
    assert rates[19] == 1.0 > rates[20]
    assert rates[-1] == 0.0
    assert one.status == fh.Status.REACTING


def leaving() -> tuple[WorkspaceSetup, fh.Waypoints, float]:
    """A workspace, a plan that leaves it, and the time of the first sample outside, s."""
    setup = replace(made(saturation=24.0), workspace=workspace_of(arm(), "-1:1,-0.5:1.2"))
    plan = fh.Waypoints([0.0, 1.5], [AWAY, (1.8, 0.2)], "quintic")
    times = 1e-3 * np.arange(1500)
    return setup, plan, float(times[np.reshape(plan(times), (-1, 2))[:, 0] > 1.0 + 2e-6][0])


@pytest.mark.ci("two kernels of a loop")
@pytest.mark.parametrize(
    "plant",
    [
        "equations",
        pytest.param("mujoco", marks=pytest.mark.ci("runs in Python, sample by sample")),
        pytest.param("library", marks=pytest.mark.ci("compiles C twice")),
    ],
)
def test_a_move_out_of_the_workspace_comes_to_rest_on_its_path(
    plant: str, tmp_path: Path, needs_compiler: Callable[..., None]
) -> None:
    """Half of the braking time behind the edge, wherever it runs; only reported, it goes on to its goal."""
    setup, plan, edge = leaving()
    options: dict[str, Any] = {
        "reference": fh.Moving(plan, arm().inverse_dynamics), "duration": 2.5,
        "initial_state": arm().operating_point(AWAY)[0],
    }  # fmt: skip

    def made_run(controller: fh.Controller) -> Any:
        if plant == "equations":
            return fh.Loop(setup.true_plant, controller).run(**options)
        loop = fh.Loop(MuJoCoPlant(arm(), measured=BOTH), controller)
        if plant == "mujoco":
            return loop.run(**options)
        needs_compiler("cc")
        library = fh.load_compiled(fh.compile_controller(controller, tmp_path / "arm.so"))
        run = fh.run_realtime(loop, **options, library=library, real_time=False)
        assert bool(np.any(run.status & fh.Status.REACTING)) == controller.mode.brakes
        return run.trajectory

    run = made_run(deployed(setup, AWAY))
    stopped, goal = np.reshape(plan(edge + 0.15), -1), np.array([1.8, 0.2])
    commanded, time = run.signals["reference"], run.time
    late = commanded[time >= edge + 0.301]
    assert late == pytest.approx(np.tile(reference(stopped), (len(late), 1)), abs=1e-9)
    speed = np.gradient(commanded[:, :2], time, axis=0)[1:-1]
    velocities = [run.names["reference"].index(f"link_velocity_{joint}") for joint in setup.joints]
    assert commanded[1:-1, velocities] == pytest.approx(speed, abs=1e-3)
    assert run.signals["state"][-1, :2] == pytest.approx(stopped, abs=1e-3)
    told = made_run(deployed(setup, AWAY, supervision=replace(setup.supervision, reactions={})))
    assert told.signals["state"][-1, :2] == pytest.approx(goal, abs=1e-3)
    before = time < edge
    assert run.signals["input"][before] == pytest.approx(told.signals["input"][before], abs=1e-7)


@pytest.mark.ci("a move with a kernel of its own")
def test_an_input_at_its_limit_for_long_brakes_the_move() -> None:
    """A stuck elbow: a load that the motor cannot move away."""
    setup = made(saturation=24.0)
    plan = fh.Waypoints([0.0, 3.0], [AWAY, (0.9, -1.1)], "quintic")
    watch = replace(setup.supervision, reactions={"saturation": "brake"})
    run = fh.Loop(setup.true_plant, deployed(setup, AWAY, supervision=watch, governor=None)).run(
        fh.Moving(plan, arm().inverse_dynamics), {"link_torque_elbow": fh.Step(60.0, at=0.5)}, duration=2.5,
        initial_state=arm().operating_point(AWAY)[0],
    )  # fmt: skip
    full = np.abs(run.signals["input"]).max(axis=1) >= 0.999 * 24.0
    since = next(k for k in range(len(full)) if k > 200 and np.all(full[k - 200 : k + 1]))
    commanded = run.signals["reference"][:, :2]
    assert commanded[:since] == pytest.approx(np.reshape(plan(run.time), (-1, 2))[:since], abs=1e-12)
    assert np.ptp(commanded[since + 310 :], axis=0).max() < 1e-12


@pytest.mark.ci("compiles a controller that watches")
@pytest.mark.parametrize("what", ["no power", "elsewhere"])
def test_an_arm_that_does_not_follow_is_said_and_slows_its_path(what: str) -> None:
    """Motors without power, as of a brake that stays closed; and a robot that stands 0.35 rad beside its start."""
    setup, away = made(peak_speed=3.0), 0.35 * (what == "elsewhere")
    plan = fh.Waypoints([0.0, 2.0], [AWAY, (0.9, -1.1)], "quintic")
    controller, time, noise = deployed(setup, AWAY), 0.0, np.random.default_rng(1)
    for k in range(1500):
        pose, y = np.reshape(plan(time), -1), noisy(resting((AWAY[0] + away, AWAY[1])), noise)
        controller.step(y, reference(pose if away == 0.0 else AWAY))
        apart = max(np.abs(pose - AWAY)) if away == 0.0 else away
        if k > 1 and abs(apart - 0.3) > 2e-3:  # a sample of latency
            assert bool(controller.status & fh.Status.FOLLOWING_ERROR) == (apart > 0.3)
        time += 1e-3 * controller.path_rate
    assert fh.Status.FOLLOWING_ERROR | fh.Status.INCONSISTENT in controller.status  # inputs that move nothing
    assert controller.path_rate == pytest.approx(0.0, abs=1e-12)
    assert time < 0.9


@pytest.mark.ci("compiles the controller that brakes")
def test_after_braking_it_begins_again_where_it_rests_and_may_come_back(
    needs_compiler: Callable[..., None], braking: Callable[[], Any]
) -> None:
    """Reset outside of the box: commands there are told, and do not brake again until one leaves the box once more."""
    needs_compiler("cc")
    _, plan, edge = leaving()
    out = np.reshape(plan(edge + 0.15), -1)
    controller, library = braking()
    starts = {"pose": out}, dict(zip(("state", "input"), arm().operating_point(out)))
    for one, start in zip((controller, library), starts):
        for pose in (AWAY, out):
            one.step(resting(AWAY), reference(pose))
        assert int(one.status) == fh.Status.OUTSIDE_WORKSPACE | fh.Status.REACTING
        one.reset(**start)
        for pose, said in ((out, 1), (out, 1), (AWAY, 8), (out, 9)):
            u = one.step(resting(out), reference(pose))
            assert int(one.status) == said
            assert (one.path_rate < 1.0) == (said == 9)
            if said == 1:
                assert u == pytest.approx(arm().operating_point(out)[1], abs=1e-6)


@pytest.mark.ci("drives MuJoCo's robot")
def test_a_limit_cycle_and_lasting_saturation_are_said() -> None:
    """Seven samples of delay that nobody knows make the loop oscillate between its limits while it should rest."""
    setup = made(saturation=24.0)
    watch, (x, _) = replace(setup.supervision, saturation_time=0.02), arm().operating_point()
    controller = deployed(setup, supervision=watch, protection=None)  # which would stop it
    loop = fh.Loop(MuJoCoPlant(arm(), measured=BOTH), controller, delay=0.025)
    seen = fh.run_realtime(
        loop, dict(zip(controller.commanded, reference(None))), noise=1e-4, duration=6.0, initial_state=x,
        real_time=False,
    ).status  # fmt: skip
    assert seen[0] == 0
    assert seen[-1] & fh.Status.LIMIT_CYCLE
    assert np.any(seen & fh.Status.SATURATION)


@pytest.mark.ci("drives MuJoCo's robot")
@pytest.mark.parametrize(("limit", "size"), [(None, 0.02), (24.0, 1.5e-3)])
def test_swings_at_rest_are_watched_without_limits_too(limit: float | None, size: float) -> None:
    """Encoders that swing by ±20 mrad at 5 Hz, or by 3 mrad in all, make a limit cycle of the status; their noise makes
    none in 5 s."""
    setup = made(saturation=limit)
    assert setup.supervision.modes(True, setup.governor)[2] == ("none" if limit is None else "brake")
    one, held, told = deployed(setup), resting(None), fh.Status(0)
    for k in range(5000):
        one.step(held + size * math.sin(2.0 * math.pi * 5.0 * 1e-3 * k), reference(None))
        told |= one.status
    assert fh.Status.LIMIT_CYCLE in told
    x, _ = arm().operating_point()
    quiet = fh.run_realtime(
        fh.Loop(MuJoCoPlant(arm(), measured=BOTH), one), dict(zip(one.commanded, reference(None))), noise=1e-4,
        duration=5.0, initial_state=x, real_time=False,
    )  # fmt: skip
    assert set(quiet.status.tolist()) == {0}


# Where it starts ----------------------------------------------------------------------------------------
@pytest.mark.costs("the setup of all tests here")
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("pose", [AWAY, (2.9, -2.5)])
def test_it_starts_at_rest_anywhere_in_the_workspace(
    pose: tuple[float, float], needs_compiler: Callable[..., None], braking: Callable[[], Any]
) -> None:
    """Made there, reset there, or as C: the weight is held from the first sample on, without a command."""
    needs_compiler("cc")
    held = arm().operating_point(pose)[1]
    there, elsewhere = deployed(made(), pose), deployed(made())
    elsewhere.reset(pose=pose)
    _, library = braking()
    library.reset(arm().operating_point(pose)[0])
    for _ in range(50):
        for each in (there, elsewhere):
            assert each.step(resting(pose)) == pytest.approx(held, rel=1e-9, abs=1e-9)
        assert library.step(resting(pose), reference(pose)) == pytest.approx(held, rel=1e-9, abs=1e-9)


def test_without_a_pose_it_starts_in_its_workspace() -> None:
    """At home, in the middle of a box without the home, or where a path begins."""
    assert workspace_of(arm(), "limits").home == pytest.approx(arm().home)
    assert workspace_of(arm(), "1:2,0:0.5").home == pytest.approx([1.5, 0.25])
    table = {"time": [0.0, 1.0], "shoulder": [1.0, 2.0], "elbow": [1.0, -1.0]}
    assert workspace_of(arm(), table).home == pytest.approx([1.0, 1.0])
    far = workspace_of(arm(), "x=-0.4:-0.2")
    assert far.contains(far.home)
    away = replace(made(), workspace=workspace_of(arm(), "1:2,-1:-0.5"))
    assert deployed(away).operating_reference[:2] == pytest.approx([1.5, -0.75])


class Encoders(MuJoCoPlant):
    """An encoder of a link is off by 0.5 mrad."""

    def output(self) -> np.ndarray:
        return super().output() + np.array([5e-4, 0.0, 0.0, 0.0])


@pytest.mark.ci("drives MuJoCo's robot for eight seconds")
def test_offsets_of_encoders_act_slowly() -> None:
    """The link goes where its encoder says, without a jump: inputs are a tenth of those without the ramp."""
    setup, peaks = made(), []
    x, u = arm().operating_point(AWAY)
    for time in (None, OFFSET_TIME):
        controller = deployed(setup, AWAY, offset_time=time)
        box = Encoders(arm(), measured=BOTH)
        run = fh.Loop(box, controller).run(
            dict(zip(controller.commanded, reference(AWAY))), duration=4.0, initial_state=x
        )
        moved = run.signal("state", "link_position_shoulder") - AWAY[0]
        assert moved[-1] == pytest.approx(-5e-4, rel=0.01)
        peaks.append([np.abs(run.signals["input"] - u).max(), np.abs(moved).max()])
    (jump, swing), (push, drift) = peaks
    assert push < 0.1 * jump
    assert drift < swing
    assert deployed(setup).offset_time == OFFSET_TIME


@pytest.mark.ci("drives MuJoCo's robot")
@pytest.mark.oracle
@pytest.mark.parametrize(
    "measured",
    [
        BOTH,
        pytest.param(("motor_position",), marks=pytest.mark.nightly("one encoder a joint")),
        pytest.param(("link_position",), marks=pytest.mark.nightly("one encoder a joint")),
    ],
)
def test_offsets_move_links_as_the_linear_loop_says(measured: tuple[str, ...]) -> None:
    """Runs against MuJoCo's robot, one for each encoder that is off; the worst signs are those of the largest sum."""
    setup, kind = made(measured=measured), measured[-1]
    x, _ = arm().operating_point(AWAY)
    for time in (OFFSET_TIME, None):
        moved = []
        for joint in arm().joint_names:

            class Off(MuJoCoPlant):
                def output(self, name: str = f"{kind}_{joint}") -> np.ndarray:
                    return super().output() + OFFSET * (np.array(self.outputs) == name)

            controller = deployed(setup, AWAY, offset_time=time)
            run = fh.Loop(Off(arm(), measured=measured), controller).run(
                dict(zip(controller.commanded, reference(AWAY))), duration=6.0, initial_state=x
            )
            moved.append(run.signals["state"][:, :2] - np.array(AWAY))
        sizes = np.abs(moved).sum(axis=0)
        largest, rest = setup.encoder_offsets(np.array(AWAY), time)
        assert sizes.max(axis=0) == pytest.approx(largest, rel=0.03)
        assert sizes[-1] == pytest.approx(rest, rel=0.01, abs=2e-6)


def test_offsets_of_an_unstable_loop_have_no_end() -> None:
    setup = made(unknown_delay=0.05)
    assert np.isinf(setup.encoder_offsets(np.array(AWAY))).all()


# Noise, and motors without limits -----------------------------------------------------------------------
@pytest.mark.ci("a robot of its own")
def test_noise_is_that_of_each_joints_unit() -> None:
    """0.1 mrad, 10 µm; torques that twist the spring so; a stated list as it stands."""
    setup = made("scara", measured=("link_position", "joint_torque"))
    stiffness = np.array([12e3, 5e3, 4e5, 300.0])
    position = np.array([1e-4, 1e-4, 1e-5, 1e-4])
    assert setup.noise == pytest.approx(np.concatenate([position, position * stiffness]))
    assert setup.position_noise == pytest.approx(position**2)
    assert setup.position_resolution(3.0) == pytest.approx(3e-4)

    def noise(stated: Any) -> Any:
        s = fh.Specification(measured=("link_position", "joint_torque"), measurement_noise=stated)
        return replace(setup, specification=s).noise

    assert noise("1e-10,0.04") == pytest.approx([1e-5] * 4 + [0.2] * 4)
    each = (1e-8, 4e-8, 1e-12, 1e-8, 0.01, 0.01, 4.0, 1e-4)
    assert noise(each) == pytest.approx(np.sqrt(each))
    with refused_with(SpecificationError, "link_position", 3):
        noise("1e-8,1e-8,1e-8")


def test_a_motor_without_a_limit_is_weighed_by_what_it_moves() -> None:
    """The input of the inverse dynamics for an acceleration of one joint at rest, at the worst of many poses."""
    setup, n, worst = made(), 2, np.zeros(2)
    for pose in setup.workspace.sample(200, 5):
        held = arm().operating_point(pose)[1]
        for k in range(n):
            pushed = arm().inverse_dynamics(pose, ddq=ACCELERATION * np.eye(n)[k])[1]
            worst[k] = max(worst[k], (abs(held) + np.abs(pushed - held))[k])
    assert setup.authority == pytest.approx(worst, rel=0.1)
    assert made(saturation=(24.0, math.inf)).authority == pytest.approx([24.0, worst[1]], rel=0.1)


# Robots, sensors, loops ---------------------------------------------------------------------------------
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("paper", {"saturation": 48.0}), ("quanser-rotflex", {}), ("vertical-rig", {"measured": ("motor_position",)}),
        ("planar-two-link", {"extras": ("coulomb_friction", "inductance"), "quantisation": 1e-5}),
        ("planar-two-link", {"period": 2e-3, "latency": 3}), ("planar-two-link", {"period": 5e-3}),
        ("planar-two-link", {"latency": 0, "unknown_delay": 1e-3}), ("planar-two-link", {"estimator": "none"}),
        ("planar-two-link", {"measured": ("motor_position", "joint_torque")}), ("scara", {"measurement_noise": 1e-10}),
        ("planar-two-link", {"measured": UNLIKE}),
        ("scara", {"measured": ("link_position", "joint_torque"), "measurement_noise": PRECISE}),
    ],
)  # fmt: skip
def test_a_move_arrives(name: str, fields: dict[str, Any]) -> None:
    setup = made(name, 20.0, **fields)
    goals, _ = setup.goals(2, 7)
    last = setup.move(goals).response.run.signals["state"][
        -round(0.3 / setup.specification.period) :, : len(setup.joints)
    ]
    assert np.abs(last - goals[1]).max() < 1e-3


@pytest.mark.ci("drives MuJoCo's robot")
def test_a_payload_is_carried_from_the_start() -> None:
    """Half a kilogram that no model knows: the arm arrives, and starts with less error than without the ramp."""
    setup, heavy, peaks = made(saturation=24.0), fh.load_robot("planar-two-link", payload="0.5kg"), []
    (start, goal), _ = setup.goals(2, 7)
    plan = fh.Waypoints([0.0, 0.5, 2.0], [start, start, goal], "quintic")
    for time in (None, OFFSET_TIME):
        run = fh.Loop(heavy.plant(BOTH), deployed(setup, start, offset_time=time)).run(
            fh.Moving(plan, arm().inverse_dynamics), duration=4.0,
            initial_state=heavy.operating_point(start)[0],
        )  # fmt: skip
        path = np.array([np.reshape(plan(t), -1) for t in run.time])
        error = np.abs(run.signals["state"][: len(path), :2] - path).max(axis=1)
        assert error[-300:].max() < 1e-3
        peaks.append(error[:500].max())
    assert peaks[1] < 0.5 * peaks[0]


@pytest.mark.ci("a kernel for a campaign; campaigns have quick tests of their own")
def test_a_campaign_of_robots_makes_a_move() -> None:
    setup = made(saturation=24.0)
    (start, goal), _ = setup.goals(2, 7)
    plan = fh.Waypoints([0.0, 1.5], [start, goal], "quintic")
    loop = fh.Loop(setup.true_plant, deployed(setup, start))
    found = fh.run_campaign(
        loop, arm().draw, 4, metrics={"error": lambda run: float(np.abs(run.signals["state"][-1, :2] - goal).max())},
        reference=fh.Moving(plan, arm().inverse_dynamics), duration=3.0,
        initial_state=arm().operating_point(start)[0],
    )  # fmt: skip
    assert float(found["error"].max()) < 2e-3


@pytest.mark.ci("drives MuJoCo's robot")
def test_a_run_on_the_robot_of_mujoco_is_a_move_from_the_stated_start(tmp_path: Path) -> None:
    """Of a controller from a file, which begins at home; bare start and goal are those of a run's options."""
    pytest.importorskip("mujoco")
    setup = made(saturation=24.0)
    deployed(setup).save(tmp_path / "controller")
    controller = fh.load_controller(tmp_path / "controller")
    s = fh.Specification(measured=BOTH, start=AWAY, pose=(0.2, -0.6))
    prepared = prepare_run(controller, (arm(), setup.specification), arm(), s)
    run = fh.run_realtime(prepared.loop, **prepared.arguments, real_time=False)
    assert prepared.plan is not None
    assert run.trajectory.signals["state"][0, :2] == pytest.approx(AWAY)
    assert np.abs(run.trajectory.signals["state"][-1, :2] - (0.2, -0.6)).max() < 1e-3
    assert set(run.status.tolist()) == {0}
    assert [line for line in prepared.requirements(run) if not line.met] == []


@pytest.mark.ci("a design of its own")
@pytest.mark.parametrize("kind", ["pose", "move"])
def test_a_run_rests_for_a_second_and_is_judged_as_the_moves_of_its_design(kind: str) -> None:
    """Half a second of motion, the shortest, then a whole one of rest: what remains is judged, not by the travel."""
    pytest.importorskip("mujoco")
    setup, goal = made(saturation=24.0), np.add(AWAY, (0.05, -0.05))
    options: dict[str, Any] = {"start": AWAY, "pose": tuple(goal)}
    if kind == "move":
        options = {"move": fh.Waypoints([0.0, 0.6], [AWAY, goal], "quintic")}
    s = fh.Specification(measured=BOTH, saturation=24.0, **options)
    prepared = prepare_run(deployed(setup), (arm(), setup.specification), arm(), s)
    assert prepared.plan is not None
    assert prepared.arguments["duration"] == pytest.approx(prepared.plan.duration + 1.0)
    stated = [arm().nominal[f"damping_{joint}"] for joint in arm().joint_names]
    np.testing.assert_allclose(prepared.box.model.tendon_damping, stated)  # as its design is judged
    run = fh.run_realtime(prepared.loop, **prepared.arguments, real_time=False)
    lines = {line.what: line for line in prepared.requirements(run)}
    assert lines["remaining error"].limit == pytest.approx(1e-3)
    last = run.trajectory.time >= run.trajectory.time[-1] - 0.3
    error = np.abs(run.trajectory.signals["state"][last, :2] - goal).max()
    assert lines["remaining error"].found == pytest.approx(error, rel=1e-6)
    assert any("ripple" in what for what in lines)


# As C ---------------------------------------------------------------------------------------------------
@pytest.mark.ci("compiles C")
@pytest.mark.parametrize(
    "name",
    ["planar-two-link", pytest.param("seven-link", marks=pytest.mark.nightly("the C of seven joints"))],
)
def test_the_c_of_a_moving_command_is_the_simulation(
    name: str, needs_compiler: Callable[..., None], tmp_path: Path
) -> None:
    """Its own M(q), bit by bit where the processor fuses multiply-adds, no memory from the system, no endless loop."""
    needs_compiler("cc")
    controller = deployed(made(name))
    samples = record(controller)
    assert np.all(np.ptp(samples.r[:, : len(arm(name).joint_names)], axis=0) > 0.05)
    assert np.all(np.ptp(samples.u, axis=0) > 0.0)
    library = fh.load_compiled(fh.compile_controller(controller, tmp_path / "arm.so"))
    for y, r, u, code in zip(samples.y, samples.r, samples.u, samples.codes):
        mine = library.step(None if code == "PREDICTED" else y, r)
        np.testing.assert_array_equal(mine, u)
    text = (fh.export_c(controller, tmp_path / "c", "arm", limits=False) / "arm.c").read_text(
        encoding="utf-8"
    )
    code = re.sub(r"/\*.*?\*/", " ", text, flags=re.DOTALL)  # without comments
    assert not {"malloc", "calloc", "while"} & set(re.findall(r"\w+", code))
