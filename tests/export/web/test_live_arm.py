"""The arms of a page compute what Python computes: plant, controller, command, kinematics, parameters."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.export.web.conftest import Run, moving_live_arm
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.export.web import LiveArm
from flexhinf.loop import Moving, Waypoints
from flexhinf.plant import sub_steps
from flexhinf.robot import Parameter
from flexhinf.robot.kinematics import link_frames, skeleton

CI = pytest.mark.ci("compiles an arm to WebAssembly, and runs it in Node")

#: Roundings of sums in another order, and of sines; relative to the numbers' own size.
ROUNDING = 1e-12


def in_javascript(values: Any) -> str:
    return json.dumps(np.asarray(values, dtype=float).tolist())


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize("name", sorted(fh.catalogue()))
def test_the_numbers_of_a_robot_are_packed_as_in_python(name: str) -> None:
    """Every robot of the catalogue: the traced function gives the bits of `Robot.plant_parameters`."""
    robot = fh.load_robot(name)
    controller = fh.Controller(fh.linear_law(_problem(robot), gamma=np.inf), None, 1e-3)
    arm = LiveArm(controller, robot, np.array(robot.home), np.array(robot.home))
    for seed in range(3):
        drawn = robot.draw(np.random.default_rng(seed))
        numbers = arm.loaded.nominal | drawn.numbers  # type: ignore[attr-defined]
        packed = np.ravel(np.asarray(arm._pack([numbers[key] for key in arm.numbers])))
        wanted = np.concatenate([np.ravel(drawn[key]) for key in arm.plant.parameters.names])
        np.testing.assert_allclose(packed, wanted, rtol=1e-14, atol=1e-15)


def test_where_a_gear_has_a_curve_it_is_followed_and_a_stiffness_has_no_slider() -> None:
    robot = fh.load_robot("planar-two-link")
    k = robot.nominal["stiffness_shoulder"]
    numbers = {"first_stiffness": 0.7 * k, "second_stiffness": 1.3 * k, "first_torque": 3.0}
    robot = robot.with_parameters(*(Parameter(f"{name}_shoulder", x, 5.0) for name, x in numbers.items()))
    controller = fh.Controller(fh.linear_law(_problem(robot), gamma=np.inf), None, 1e-3)
    home, curve = np.array(robot.home), "stiffness_curve"
    arm = LiveArm(controller, robot, home, home, (curve,))
    names = [row["name"] for row in arm.sliders]
    assert "stiffness_elbow" in names
    assert "first_stiffness_shoulder" in names
    assert "stiffness_shoulder" not in names
    motion = np.random.default_rng(0).normal(size=(5, 2))
    x, u = robot.inverse_dynamics(*motion, extras=curve)
    followed = np.asarray(arm._inverse(*motion, arm.plant.parameters.vector()), dtype=float).ravel()
    assert followed == pytest.approx(np.concatenate([x, u]))


def _problem(robot: fh.Robot) -> Any:
    weights = {"link_position": 60.0, "link_position_integral": 300.0}
    return robot.problem(robot.penalty or weights, pose=robot.home)


@pytest.mark.oracle
def test_a_payload_is_part_of_its_link(two_links: LiveArm) -> None:
    mass = two_links.payloads[0]["name"]
    numbers = two_links.loaded.nominal | {mass: 0.3}
    packed = two_links.plant.parameters.named(np.ravel(np.asarray(two_links._pack(list(numbers.values())))))
    assert packed.mass[1] == pytest.approx(two_links.robot.nominal["mass_elbow"] + 0.3)
    assert packed.mass[0] == two_links.robot.nominal["mass_shoulder"]
    loaded = fh.load_robot("planar-two-link", payload="0.3kg")
    assert packed.inertia == pytest.approx(loaded.plant_parameters()["inertia"], rel=1e-12)


@pytest.mark.ci("compiles a plant")
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "extras"),
    [
        pytest.param("planar-two-link", ("inductance",), marks=CI),
        pytest.param("scara", ("coulomb_friction",), marks=pytest.mark.nightly("one more robot")),
        pytest.param("spatial-three-link", (), marks=CI),
    ],
)
def test_a_period_of_the_plant_is_that_of_scipy(name: str, extras: tuple[str, ...], run: Run) -> None:
    """Other numbers than nominal, a torque on the links, and the input that held the arm before."""
    from scipy.integrate import solve_ivp

    arm = moving_live_arm(name, extras=extras)
    robot, plant = arm.robot, arm.plant
    rng = np.random.default_rng(1)
    drawn = robot.draw(rng)
    x, u = robot.operating_point(arm.start, extras)
    x = x + 0.05 * rng.standard_normal(len(x))
    torque = 0.3 * rng.standard_normal(len(u))
    p = np.concatenate([np.ravel(drawn[key]) for key in plant.parameters.names])
    steps = 4 * sub_steps(arm.controller.period, float(arm.fastest))  # dry friction turns sharply
    numbers = arm.loaded.nominal | drawn.numbers  # type: ignore[attr-defined]
    got = run(arm, f"""
      simulation.sensing = false;
      simulation.latency = 0;
      s.steps = [{steps}, {steps}];
      simulation.setConditions();
      simulation.numbers[1].set({in_javascript(list(numbers.values()))});
      simulation.code.set_numbers(1);
      simulation.view(simulation.code.state_at(1), {plant.n}).set({in_javascript(x)});
      simulation.pushed.set({in_javascript(torque)});
      simulation.advance(1);
      return [simulation.view(simulation.code.state_at(1), {plant.n}), simulation.inputs[1]].map((v) => Array.from(v));
    """)  # fmt: skip
    held, disturbance = np.array(got[1]), np.concatenate([torque, np.zeros(len(torque))])
    np.testing.assert_allclose(held, u, rtol=1e-9, atol=1e-9)

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        return np.ravel(np.asarray(plant.traced_flow(state, held, disturbance, p), dtype=float))

    exact = solve_ivp(rates, (0.0, arm.controller.period), x, method="DOP853", rtol=1e-12, atol=1e-13).y[
        :, -1
    ]
    np.testing.assert_allclose(got[0], exact, rtol=1e-9, atol=1e-9)


#: Runs arm 0 and says of every sample the state before it and the input that acts after it.
RECORDED = """
  s.steps = [{steps}, 1];
  simulation.pdOn = false;
  simulation.setConditions();
  simulation.goTo({goal});
  const states = [], inputs = [], n = {n};
  for (let k = 0; k < {samples}; k++) {{
    states.push(Array.from(simulation.view(simulation.code.state_at(0), n)));
    simulation.advance(1);
    inputs.push(Array.from(simulation.inputs[0]));
  }}
  return [states, inputs];
"""


@CI
@pytest.mark.oracle
def test_the_controller_of_a_step_is_that_of_python(paper: LiveArm, run: Run) -> None:
    """The outputs that Python's controller computes of what the page's arm measured, each a sample later."""
    goal = np.array([np.pi / 2.0])
    states, inputs = map(
        np.array, run(paper, RECORDED.format(steps=2, goal=in_javascript(goal), n=4, samples=600))
    )
    controller = paper.controller.fresh()
    x, u = paper.robot.operating_point(paper.start)
    controller.reset(x, u)
    wanted = np.array([u, *(controller.step(state[:1], goal) for state in states)])[:-1]
    assert np.ptp(wanted) > 5.0
    np.testing.assert_allclose(inputs, wanted, rtol=0.0, atol=ROUNDING * 48.0)
    assert abs(states[-1][0]) > 0.3


@CI
@pytest.mark.oracle
def test_the_controller_of_a_motion_is_that_of_python(two_links: LiveArm, run: Run) -> None:
    """The command along a quintic, with its feedforward, is that of `Moving`; so are the inputs."""
    goal, arm = two_links.goal, two_links
    length = max(0.5, 1.875 * 0.1)
    states, inputs = map(
        np.array, run(arm, RECORDED.format(steps=2, goal=in_javascript(goal), n=8, samples=700))
    )
    controller, robot = arm.controller.fresh(), arm.robot
    x, u = robot.operating_point(arm.start)
    controller.reset(x, u)
    plan = Waypoints([0.0, length], [arm.start, goal], "quintic")
    moving, period = Moving(plan, robot.inverse_dynamics), controller.period
    wanted = [u]
    for k, state in enumerate(states):
        at = (k + 1) * period
        r = np.concatenate([np.ravel(moving.state(at)), np.ravel(moving.input(at))])
        y = np.ravel(
            np.asarray(arm.plant.traced_output(state, u, arm.plant.parameters.vector()), dtype=float)
        )
        wanted.append(controller.step(y, r))
    wanted = np.array(wanted[:-1])
    np.testing.assert_allclose(inputs, wanted, rtol=0.0, atol=1e-9 * np.abs(wanted).max())
    assert np.abs(states[-1][:2] - goal).max() < 1e-3


@pytest.mark.oracle
@pytest.mark.parametrize("name", ci_and_night("compiles an arm", ["paper", "spatial-three-link"], ["scara"]))
def test_the_frames_are_those_of_the_kinematics(name: str, run: Run) -> None:
    arm = moving_live_arm(name)
    q = np.array(arm.start) + 0.3
    frames = run(arm, f"return simulation.frames({in_javascript(q)})")
    turns, places = link_frames(arm.robot, q)
    for frame, turn, place in zip(frames, turns, places, strict=True):
        np.testing.assert_allclose(np.reshape(frame["turn"], (3, 3)), turn, atol=1e-14)
        np.testing.assert_allclose(frame["at"], place, atol=1e-14)
    lines = skeleton(arm.robot, q)
    for line, end, turn, place in zip(lines, arm.ends, turns, places, strict=True):
        if end is not None:
            np.testing.assert_allclose(line[-1], place + turn @ np.array(end), atol=1e-14)


@CI
@pytest.mark.oracle
def test_the_pd_is_what_the_page_says(paper: LiveArm, run: Run) -> None:
    """u = u_d − K_p (θ − θ_d) − K_d θ̇_f with the filtered difference, from a motor that is turned by 0.01 rad."""
    states, inputs = map(np.array, run(paper, """
      simulation.latency = 0;
      simulation.setConditions();
      simulation.states[1][2] += 0.01;
      const states = [], inputs = [];
      for (let k = 0; k < 50; k++) {
        states.push(Array.from(simulation.states[1]));
        simulation.advance(1);
        inputs.push(Array.from(simulation.inputs[1]));
      }
      return [states, inputs];
    """))  # fmt: skip
    gains, seen, speed = paper.rival, 0.0, 0.0
    for state, u in zip(states, inputs, strict=True):
        speed += (1.0 - np.exp(-gains.cutoff[0] * 1e-3)) * ((state[2] - seen) / 1e-3 - speed)
        seen = state[2]
        assert u == pytest.approx(-gains.proportional * state[2] - gains.derivative * speed, rel=1e-9)


@CI
def test_links_of_a_stiff_pd_swing_after_a_fast_move(two_links: LiveArm, run: Run) -> None:
    """The tuned one with feedforward does not, nor does the stiff one at rest."""
    tuned, stiff, resting = run(two_links, """
      const swing = (on, pose, fast) => {
        simulation.reset(s.start);
        simulation.setStiff(on);
        simulation.goTo(pose, fast);
        simulation.advance(Math.round((fast + 0.1) / s.period));
        let most = 0;
        for (let k = 0; k < 500; k++) {
          simulation.advance(1);
          most = Math.max(most, ...simulation.links(1).map((q, j) => Math.abs(q - pose[j])));
        }
        return most;
      };
      const away = s.start.map((q) => q + 0.8);
      return [swing(false, away, s.fast), swing(true, away, s.fast), swing(true, s.start, s.fast)];
    """)  # fmt: skip
    assert stiff > 0.15
    assert tuned < 0.3 * stiff
    assert resting < 1e-3


@pytest.mark.parametrize("times", ci_and_night("compiles an arm, runs it in Node", [1.0], [20.0]))
def test_the_tuned_pd_comes_to_rest_at_every_pose(times: float, run: Run) -> None:
    """After a push, at start, goal and ends of the joints' ranges, with perturbed arms too."""
    arm = moving_live_arm("spatial-three-link")
    robot = arm.robot
    stiff = [replace(p, value=times * p.value) for p in robot.parameters if p.name.startswith("stiffness")]
    arm = replace(arm, robot=robot.with_parameters(*stiff))
    late, early = run(arm, """
      const late = [], early = [], n = s.joints.length;
      const ends = [...Array(2 ** n).keys()].map((k) => s.low.map((low, j) => (k >> j & 1 ? s.high[j] : low)));
      simulation.pairs = 4;
      for (const pose of [s.start, s.goal, ...ends]) {
        simulation.reset(pose);
        simulation.pushed.set(s.push.map((torque) => 0.1 * torque));
        simulation.advance(50);
        simulation.pushed.fill(0);
        const speed = (k) => Math.max(...simulation.states[k].subarray(n, 2 * n).map(Math.abs));
        const speeds = () => [1, 3, 5, 7, 9].map(speed);
        early.push(speeds());
        simulation.advance(6000);
        late.push(speeds());
      }
      return [late, early];
    """)  # fmt: skip
    assert (np.array(late) < 0.2 * np.array(early)).all()


@CI
def test_a_pull_acts_through_the_jacobian(two_links: LiveArm, run: Run) -> None:
    """The torques of the hand's force, times a small motion of the joints, are its work on the point held."""
    got = run(two_links, """
      simulation.hold(1, [0.1, 0.02, 0], 5, 3);
      const q = simulation.links(0), work = [];
      const point = (pose) => { const f = simulation.frames(pose)[1];
        return [0, 1, 2].map((k) => f.at[k] + f.turn[3 * k] * 0.1 + f.turn[3 * k + 1] * 0.02); };
      simulation.hand.set(point(q).map((v, k) => v + [0.1, 0.3, 0.0][k]));
      const before = point(q);
      simulation.advance(1);
      const force = Array.from(simulation.force), torque = Array.from(simulation.view(simulation.code.torque_at(), 2));
      const slopes = [0, 1].map((j) => { const moved = [...q]; moved[j] += 1e-6;
        return point(moved).reduce((sum, v, k) => sum + force[k] * (v - before[k]) / 1e-6, 0); });
      simulation.hand.set(point(simulation.links(0)).map((v, k) => v + [9, 0, 0][k]));
      simulation.advance(1);
      const strongest = Math.hypot(...simulation.force);
      simulation.hold(-1, null, 1, 1);
      simulation.advance(1);
      return { torque, slopes, strongest, after: Array.from(simulation.view(simulation.code.torque_at(), 2)) };
    """)  # fmt: skip
    assert got["torque"] == pytest.approx(got["slopes"], rel=1e-4)
    assert got["strongest"] == pytest.approx(3.0)
    assert got["after"] == [0.0, 0.0]


@CI
def test_the_same_seed_makes_the_same_arms(paper: LiveArm, run: Run) -> None:
    arm = paper
    got = run(arm, """
      const numbers = () => simulation.numbers.map((v) => Array.from(v));
      const first = numbers();
      simulation.seed = 2; simulation.setNumbers();
      const other = numbers();
      simulation.seed = 1; simulation.setNumbers();
      return { first, other, again: numbers() };
    """)  # fmt: skip
    assert got["first"] == got["again"]
    assert got["first"][0] == got["other"][0]  # the arm itself is no sample
    assert got["first"][2] != got["other"][2]
    names = list(arm.numbers)
    for row in got["first"][2:]:
        for parameter in arm.robot.uncertain:
            low, high = parameter.interval
            assert low <= row[names.index(parameter.name)] <= high
    assert np.ptp([row[names.index("stiffness")] for row in got["first"]]) > 1.0


@CI
def test_noise_and_latency_act(paper: LiveArm, run: Run) -> None:
    got = run(paper, """
      const spread = () => {
        const u = [];
        for (let k = 0; k < 200; k++) { simulation.advance(1); u.push(simulation.inputs[0][0]); }
        const mean = u.reduce((a, b) => a + b) / u.length;
        return Math.sqrt(u.reduce((a, b) => a + (b - mean) ** 2, 0) / u.length);
      };
      const quiet = spread();
      simulation.noise = 10; simulation.setConditions();
      const noisy = spread();
      simulation.noise = 0; simulation.latency = 5; simulation.setConditions(); simulation.reset(s.start);
      simulation.states[1][2] += 0.01;
      const inputs = []; for (let k = 0; k < 8; k++) { simulation.advance(1); inputs.push(simulation.inputs[1][0]); }
      return { quiet, noisy, inputs };
    """)  # fmt: skip
    assert got["noisy"] > 100.0 * got["quiet"]
    assert got["inputs"][:5] == [0.0] * 5
    assert got["inputs"][5] != 0.0


@CI
def test_an_arm_that_runs_away_is_lost(paper: LiveArm, run: Run) -> None:
    """Only that one; it begins again with all others."""
    got = run(paper, """
      const lost = () => [simulation.lost(0), simulation.lost(1)];
      simulation.states[0][1] = 1e7;
      simulation.advance(1);
      const before = lost();
      simulation.reset(s.start);
      return [before, lost()];
    """)  # fmt: skip
    assert got == [[True, False], [False, False]]
