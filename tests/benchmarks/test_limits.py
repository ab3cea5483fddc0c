"""``make bench-limits``: the true arm, its brakes, stops and backlash, the commands, the rivals' rule, the tables."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from benchmarks.limits import arms as the_arms
from benchmarks.limits.arms import ARMS, added, designed, named, noise_in, robot_of
from benchmarks.limits.encoders import Encoders, step_of
from benchmarks.limits.laws import DAMPING, RIPPLE, Product, Rival, tuned
from benchmarks.limits.paths import CURVES, curve, heaviest, held, jump, needed, whole
from benchmarks.limits.plant import Stop, TrueArm, stiff
from benchmarks.limits.pushes import pushed, pushes_of
from benchmarks.limits.rows import NONE, ROWS, Bench, kept, named_rows
from benchmarks.limits.rule import judged
from benchmarks.limits.tables import TABLES, beyond_limits, returns
from benchmarks.limits.trials import ENCODERS, FRAMES, TRIALS, drive, limits_of, noise_of
from benchmarks.limits.watched import encoded
from benchmarks.workspace.arm import LATENCY, PERIOD, SPRINGS, Arm, damped, pin
from benchmarks.workspace.goals import Reference
from scipy.integrate import solve_ivp
from tests.builders import LinearLaw

import flexhinf as fh
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.loop.controller.stop import Stop as Reason
from flexhinf.modal import ModalLaw
from flexhinf.modal.pair import PairWeights
from flexhinf.robot.workspace import workspace_of

PLANAR, ELASTIC = "planar-two-link", "elastic"


@pytest.fixture(scope="module")
def elastic() -> Arm:
    return Arm.of(robot_of(ELASTIC, None))


@pytest.fixture(scope="module")
def planar() -> Arm:
    return Arm.of(robot_of(PLANAR, None))


# The true arm ---------------------------------------------------------------------------------------
@pytest.mark.oracle
def test_the_arm_has_the_numbers_that_its_file_states(elastic: Arm) -> None:
    """Read by another reader; the payload is added to the last link."""
    file = tomllib.loads(Path(ARMS[ELASTIC].paths(None)[0]).read_text(encoding="utf-8"))
    joints, payload = file["joint"], file["payload"][0]["mass"]
    for key, part, mine in (
        ("stiffness", "spring", elastic.stiffness), ("damping", "spring", elastic.spring_damping),
        ("motor_inertia", "motor", elastic.rotor), ("friction", "motor", elastic.viscous),
        ("coulomb_friction", "motor", elastic.dry),
    ):  # fmt: skip
        assert mine == pytest.approx([joint[part][key] for joint in joints])
    masses = np.array([joint["link"]["mass"] for joint in joints])
    last = np.eye(4)[3]
    assert elastic.mass == pytest.approx(masses + last * payload["value"])
    heavy = heaviest(elastic.robot).mass
    assert np.all(heavy <= 1.05 * (masses + last * payload["range"][1]) + 1e-9)
    assert heavy[-1] > masses[-1] + payload["value"]


@pytest.mark.oracle
@pytest.mark.parametrize("gap", [0.0, 4e-3], ids=["springs", "backlash"])
def test_the_true_arm_is_scipys_solution(elastic: Arm, gap: float) -> None:
    """A twentieth of a second of free motion with the links by Pinocchio, without dry friction."""
    arm = replace(elastic, dry=np.zeros(elastic.n))
    plant, q, zero = TrueArm(arm, gap), arm.home, np.zeros(arm.n)
    plant.rest(q)
    u, start = arm.rest(q)[1] + 0.1 * arm.limit, np.concatenate([q, zero, plant.read()[1], zero])

    def rate(_: float, x: np.ndarray) -> np.ndarray:
        q, dq, theta, dtheta = np.split(x, 4)
        twist = theta - q
        spring = arm.stiffness * (twist - np.clip(twist, -0.5 * gap, 0.5 * gap))
        spring = spring + arm.spring_damping * (dtheta - dq)
        motor = (arm.per_input * u - arm.viscous * dtheta - spring) / arm.rotor
        return np.concatenate([dq, arm.acceleration(q, dq, spring), dtheta, motor])

    for _ in range(50):
        plant.advance(u)
    exact = solve_ivp(rate, (0.0, 50 * PERIOD), start, "DOP853", rtol=1e-9, atol=1e-12).y[:, -1]
    found = np.concatenate(plant.read())
    moved = np.abs(exact[[*range(4), *range(8, 12)]] - np.concatenate([q, start[8:12]]))
    assert moved.min() > 1e-3
    assert np.abs(found - exact[[*range(4), *range(8, 12)]]).max() < 0.01 * moved.max()


def test_brakes_hold_the_motors_and_let_them_go(elastic: Arm) -> None:
    plant = TrueArm(damped(elastic))
    plant.rest(elastic.home)
    before = plant.read()[1]
    plant.brake(True)
    for _ in range(300):
        plant.advance(elastic.limit)  # the drives are off
    assert plant.read()[1] == pytest.approx(before, abs=1e-4)
    plant.brake(False)
    for _ in range(100):
        plant.advance(0.0 * elastic.limit)
    assert np.abs(plant.read()[1] - before).max() > 0.01  # it falls


def test_a_stop_is_in_the_way_of_a_link_on_one_side(elastic: Arm) -> None:
    u = elastic.rest(elastic.home)[1]
    u[0] = 0.5 * elastic.limit[0]
    ends = {}
    for side in (-1.0, 1.0):
        plant = TrueArm(elastic)
        plant.rest(elastic.home)
        plant.stop = Stop(0, elastic.home[0] + side * 0.05, side)
        for _ in range(300):
            plant.advance(u)
        ends[side] = plant.read()[0][0] - elastic.home[0]
    assert ends[-1.0] > 0.1
    assert 0.0 < ends[1.0] < 0.06


def test_a_stop_throws_no_link_that_is_lighter_than_it_was_at_home(elastic: Arm) -> None:
    """Inertia by which a link was heavy for a stop's damping: the arm comes back no faster than it came."""
    springs = elastic.stiffness * [1.0, 1.0, 1.0, 300.0]
    plant = TrueArm(damped(replace(elastic, stiffness=springs)))
    plant.rest(elastic.home)
    held = elastic.rest(elastic.home)[1]
    steps, came, links = plant.sub_steps, 0.0, [plant.read()[0]]
    for k in range(400):
        if k == 100:
            plant.stop = Stop(3, links[-1][3] + 1e-3, 1.0)
            assert plant.sub_steps > steps
        plant.advance(held + 0.3 * elastic.limit * np.eye(4)[3] * (k < 120))
        links.append(plant.read()[0])
    speeds = np.abs(np.diff(links, axis=0))
    came = speeds[:110].max(axis=0)[3]
    assert speeds[110:].max() < came
    plant.stop = None
    assert plant.sub_steps == steps


def test_joints_without_springs_have_their_motors_at_the_links(elastic: Arm) -> None:
    """A very soft arm beside it: the link is where the motor is, and laws compute with a stiff spring."""
    rigid = elastic.stiffness.copy()
    rigid[-1] = np.inf
    arm = replace(elastic, stiffness=rigid)
    plant = TrueArm(damped(arm))
    plant.rest(arm.home)
    for _ in range(50):
        plant.advance(arm.limit)
    links, motors = plant.read()
    assert links[-1] == motors[-1]
    assert links[0] != motors[0]
    assert np.isfinite(stiff(arm).linear(arm.home)[0]).all()
    assert arm.fastest() < 1e4
    states = np.arange(14.0)[None]
    assert whole(arm, states)[0, 8:].tolist() == [8.0, 9.0, 10.0, 3.0, 11.0, 12.0, 13.0, 7.0]


def test_springs_are_damped_where_the_file_states_nothing(planar: Arm) -> None:
    """One joint that is far stiffer than the others vibrates alone: by the ratio that is said."""
    bare = replace(
        planar, spring_damping=np.zeros(2), viscous=np.zeros(2), stiffness=planar.stiffness * [1.0, 1e4]
    )
    given = replace(bare, spring_damping=np.array([0.0, 0.7]))
    assert damped(given).spring_damping[1] == 0.7
    values = np.linalg.eigvals(damped(bare).linear(bare.home)[0])
    fastest = values[np.argmax(np.abs(values))]
    assert -fastest.real / abs(fastest) == pytest.approx(SPRINGS, rel=0.01)


# Commands -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("shape", list(CURVES))
def test_a_curve_is_as_fast_as_its_joints_may_be_and_its_states_are_its_own(planar: Arm, shape: str) -> None:
    path, n = curve(planar, heaviest(planar.robot), shape), planar.n
    speeds = np.abs(path.states[:, n : 2 * n]).max(axis=0) / planar.speed
    at_limit = needed(heaviest(planar.robot), *_rows(path)).max() > 0.75
    assert speeds.max() <= 1.001
    assert at_limit or speeds.max() > 0.999
    rates = np.gradient(path.links, PERIOD, axis=0)[1:-1]
    assert rates == pytest.approx(path.states[1:-1, n : 2 * n], abs=2e-3 * np.abs(rates).max())
    assert path.links[0] == pytest.approx(planar.home)
    assert path.links[-1] == pytest.approx(planar.home, abs=1e-9)


def _rows(path: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rates = np.gradient(path.links, PERIOD, axis=0)
    return path.links[::10], rates[::10], np.gradient(rates, PERIOD, axis=0)[::10]


def test_encoders_tell_steps_at_their_rate_and_nothing_new_in_silence(planar: Arm) -> None:
    """A turn has 2¹³ steps; positions rise by ten steps a sample, from a quarter of one."""
    n, count = 2 * planar.n, 12
    step = np.full(n, 2.0 * np.pi / 2**13)
    assert step_of(planar, 13) == pytest.approx(step)

    def told(name: str) -> np.ndarray:
        trial, noise = (ENCODERS | FRAMES)[name], np.full((count, n), 3e-5)
        encoders = Encoders.of(planar, noise, replace(trial, bits=13, noisy=False), 4)
        return np.array([encoders.read(k, (10.0 * k + 0.25) * step) / step for k in range(count)])

    whole = np.tile(10.0 * np.arange(count)[:, None], n)
    odd = whole - 10.0 * (np.arange(count) % 2)[:, None]
    assert told("rest-13") == pytest.approx(whole)
    assert told("half-rate") == pytest.approx(odd)
    assert told("half-rate-links") == pytest.approx(np.hstack([odd[:, : planar.n], whole[:, planar.n :]]))
    silent = (np.arange(count)[:, None] >= 4) & (np.arange(count)[:, None] < 7)
    assert told("repeated-3") == pytest.approx(np.where(silent, 30.0, whole))
    assert told("missing-3") == pytest.approx(np.where(silent, np.nan, whole), nan_ok=True)


class Held:
    """A law that gives what is planned, and says one bit."""

    status, said = 0, MappingProxyType({})

    def start(self, q: np.ndarray) -> None:
        self.began, self.told = q, list[Any]()

    def step(self, y: np.ndarray, reference: Any) -> np.ndarray:
        self.status |= 4
        self.told.append(y)
        return reference.input


def test_a_run_that_stays_where_it_is_has_nothing_beyond(planar: Arm) -> None:
    """At rest in the stick of its dry friction; encoders are those that are said."""
    law, path = Held(), held(planar, planar.home, 0.2)
    plant = TrueArm(damped(planar))
    plant.rest(planar.home)
    law.start(planar.home)
    queue = [planar.rest(planar.home)[1]] * LATENCY
    run = drive(plant, law, path, queue, noise_of(planar), np.random.default_rng(0))
    assert not run.lost
    assert np.abs(run.q - planar.home).max() < 1e-6
    assert np.std(np.array(law.told)[:, 0]) == pytest.approx(1e-5, rel=0.5)


def test_a_command_that_jumps_is_at_its_goal_at_once(planar: Arm) -> None:
    path = jump(planar, planar.home, planar.home + 0.1, 0.05)
    assert path.links == pytest.approx(np.tile(planar.home + 0.1, (50, 1)))
    assert path.moving == 0


def test_a_law_that_lets_go_goes_beyond_and_does_not_come_back(
    planar: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a trial says of a law that only gives the planned input, and forgets it behind a brake."""

    class Gone(Held):
        def step(self, y: np.ndarray, reference: Any) -> np.ndarray:
            return 0.3 * planar.limit + super().step(y, reference)

    row = limits_of(planar, Gone(), TRIALS["jump-0.05"])
    assert row["lost"] or (row["beyond"] > 0.1 and row["back"] is None)
    assert row["status"] == 4


def test_a_design_runs_without_its_governor_where_that_is_named(tmp_path: Path) -> None:
    """Other reactions stay."""
    law = LinearLaw(("link_position", "link_velocity", "link_position_integral"), ("u",), -np.ones((1, 3)))
    governor = fh.loop.Governor([0.1], [1.0], [3.0], [-3.0], [3.0])
    watch = fh.Supervision(following=0.1, reactions={"following": "brake"})
    fh.Controller(law, None, PERIOD, 1.0, moving=True, governor=governor, supervision=watch).save(
        tmp_path / "controller"
    )
    assert Product(None, tmp_path).controller.governor == governor
    plain = Product(None, tmp_path, governed=False).controller
    assert plain.governor is None
    assert plain.supervision is not None
    assert dict(plain.supervision.reactions) == {"following": "brake"}


# Rivals ---------------------------------------------------------------------------------------------
@pytest.mark.ci("tries the rule's candidates, fastest first, until one keeps it")
def test_a_rival_gets_the_fastest_candidate_that_keeps_the_rule(
    planar: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Torque feedback of this arm keeps it; a faster one with a mark of its own does not."""
    monkeypatch.setattr("benchmarks.limits.laws.POSES", 4)
    found = tuned(planar, "torque", noise_of(planar))
    assert found is not None
    assert found["damping"] >= DAMPING
    assert found["ripple"] <= RIPPLE
    law = Rival(planar, "torque", found["numbers"])
    assert law.law.integral
    moving = np.concatenate([planar.home, np.ones(2), planar.rest(planar.home)[0], np.ones(2)])
    told, inputs = Reference(moving, np.zeros(2), moving), list[np.ndarray]()
    for dry in (law.dry, 0.0 * law.dry):
        law.dry = dry
        law.start(planar.home)
        inputs.append(law.step(moving[[0, 1, 4, 5]], told))
    assert inputs[0] - inputs[1] == pytest.approx(planar.dry / planar.per_input)


# Designs and rows -----------------------------------------------------------------------------------
def test_the_command_that_a_design_names_is_read() -> None:
    text = (
        "next: flexhinf design arm.toml --measured link_position,motor_position --out arm --set gain_margin=1.8 "
        "--remaining-error 0.002  # meets every requirement\n"
    )
    words = named(text)
    assert words is not None
    assert "--out" not in words
    assert added(words) == ["--set", "gain_margin=1.8", "--remaining-error", "0.002"]
    shown = "next: flexhinf export web arm  # shows this design as it is\n"
    assert named(shown) is None


def test_a_design_is_made_once_and_then_by_the_command_that_it_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def run(command: list[str], **_: Any) -> Any:
        calls.append(command)
        out = Path(command[command.index("--out") + 1])
        out.mkdir()
        (out / "design.json").write_text(json.dumps({"met": len(calls) > 1}), encoding="utf-8")
        text = "next: flexhinf design paper --x 1 --out paper.1  # meets every requirement\n"
        return type("Run", (), {"stdout": text, "returncode": 0})

    monkeypatch.setattr(the_arms.subprocess, "run", run)
    assert len(list(designed(tmp_path, "paper", None))) == 2
    assert calls[0][3:5] == ["design", "paper"]
    assert calls[1][3:7] == ["design", "paper", "--x", "1"]
    assert list(designed(tmp_path, "paper", None)) == []
    assert the_arms.design_of(tmp_path, "paper") == (tmp_path / "paper.2", 2)


def test_rows_are_kept_as_they_are_made_and_not_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(PLANAR, tmp_path, tmp_path, None)
    monkeypatch.setattr(Bench, "law", lambda *_: Held())
    monkeypatch.setattr(Bench, "one", lambda *_: {"lost": 0})
    assert list(bench.make(["stop", "met"], ["pd"])) == [f"{PLANAR} {row} PD" for row in ("stop", "met")]
    again = Bench(PLANAR, tmp_path, tmp_path, None)
    assert list(again.make(["stop"], ["pd"])) == []
    assert list(again.make(["stop"], ["pd"], again=True)) == [f"{PLANAR} stop PD"]
    assert kept(tmp_path, PLANAR) == {row: {"pd": {"lost": 0}} for row in ("stop", "met")}
    assert named_rows(["limits", "met"]) == [*TRIALS, "met"]


def test_the_rule_of_the_limits_is_judged() -> None:
    good = {"lost": 0, "beyond": 0.05, "speed": 0.9, "back": 1.0, "hold": 0.5, "status": 4}
    pd = good | {"beyond": 0.04, "speed": 3.0}
    assert judged({"flexhinf": good, "pd": good}) == "kept"
    assert judged({"flexhinf": good, "pd": pd}) == "missed: beyond"
    assert judged({"flexhinf": good | {"speed": 1.3}, "pd": good}) == "missed: speed"
    assert judged({"flexhinf": good | {"speed": 1.3, "hold": 0.95}, "pd": pd | {"beyond": 0.05}}) == "kept"
    assert judged({"flexhinf": good | {"lost": 1}, "pd": pd}) == "lost"
    assert judged({"flexhinf": good}) == "not measured"


def test_what_a_protective_stop_ends_is_listed_with_its_reason(tmp_path: Path) -> None:
    """A brake is the drive's fault; an obstacle is none, so that ending it is a false alarm."""
    own = {
        "lost": 0,
        "beyond": 0.05,
        "speed": 0.9,
        "back": 1.0,
        "hold": 0.5,
        "status": 4,
        "away": 0.1,
        "unseen": 0,
        "rejected": 0,
    }
    brake = own | {"stops": [None, [0.012, int(Reason.INCONSISTENT)]]}
    stop = own | {"stops": [[0.3, int(Reason.OSCILLATING)], [0.5, int(Reason.OSCILLATING)]]}
    late = own | {"stops": [None, None], "unseen": 1}
    push = {"stops": [[0.002, int(Reason.TOO_FAST)]]}
    rows = {name: {"flexhinf": row} for name, row in (("brake-0.1", brake), ("stop", stop), ("late", late))}
    rows["pushes"] = {"flexhinf": {"pushes": [push, {"stops": [None]}, {}]}}
    (tmp_path / "paper.json").write_text(json.dumps(rows), encoding="utf-8")
    _, _, *listed, _, counts = TABLES["stops"](tmp_path).splitlines()
    braked, held, pushed = ([cell.strip() for cell in row.split("|")[1:]] for row in listed)
    assert braked[1:3] == ["inconsistent", "paper 1: 12 ms"]
    assert braked[3].startswith("the drive")
    assert held[1:3] == ["oscillating", "paper 2: 300 to 500 ms"]
    assert held[3].startswith("**false alarm**")
    assert pushed[:3] == ["a push", "too fast", "paper 1: 2 ms"]
    assert re.findall(r"\d+", counts) == ["3", "6", "1", "2"]

    def missed(name: str, row: dict[str, Any], pd: float = 1.0) -> list[str]:
        return encoded(ENCODERS[name], {"flexhinf": row, "pd": own | {"beyond": pd}})

    assert missed("brake-13", brake) == []
    assert missed("rest-13", brake) == ["stop"]
    assert missed("brake-13", stop) == ["stop"]
    assert missed("half-rate", late) == []
    assert missed("rest-13", late) == ["missing"]
    assert missed("half-rate", own | {"stops": [None], "rejected": 1}) == ["missing"]
    assert missed("rest-13", late | {"lost": 1}) == ["lost", "missing"]
    assert missed("slow-13", own | {"stops": [None]}, 0.01) == ["beyond"]


def test_moves_beyond_a_limit_of_the_design_are_counted(tmp_path: Path) -> None:
    limits = {"remaining error": 1e-3, "tracking error": 5e-3}
    run = {
        "moves": 3, "run": 2, "lost": 0, "remaining error": [5e-4, 2e-3], "tracking error": [1e-3, 1e-3],
        "motion the wrong way": [9.0, 9.0], "ripple of the motors": [9.0, 9.0],
    }  # fmt: skip
    assert beyond_limits(limits, run) == 2  # one beyond, one not run
    design = {
        "met": True,
        "command": 2,
        "more": ["--x", "1"],
        "missed": ["ripple"],
        "limits": limits,
        "noise": 1e-4,
    }
    (tmp_path / "paper.json").write_text(
        json.dumps({"design": design, "met": {"flexhinf": run}}), encoding="utf-8"
    )
    text = TABLES["met"](tmp_path)
    cells = text.splitlines()[2].strip("| ").split(" | ")
    assert cells[1] == "with `--x 1`"
    assert re.findall(r"\d+", cells[3]) == ["2", "1", "1", "5"]
    assert re.findall(r"\d+", cells[4]) == ["2", "3"]
    assert re.findall(r"\d+", text.splitlines()[-1]) == ["0", "1", "0"]
    rows = {"design": design, "met": {"flexhinf": run, "pd": run | {"lost": 1}}}
    (tmp_path / "paper.json").write_text(json.dumps(rows), encoding="utf-8")
    assert re.findall(r"\d+", TABLES["rest"](tmp_path).splitlines()[2]) == ["1", "1", "3", "2", "1", "3", "1"]
    rows["tuned"] = {"torque": None}
    (tmp_path / "paper.json").write_text(json.dumps(rows), encoding="utf-8")
    assert TABLES["rest"](tmp_path).splitlines()[2].endswith(f"{NONE} |")
    assert NONE in TABLES["rivals"](tmp_path)
    assert "`paper`" in TABLES["short"](tmp_path).splitlines()[-1]


def test_the_noise_of_a_design_is_that_of_its_file() -> None:
    """Of joints that turn, and of those that slide where they have a number of their own."""
    assert noise_in("# measurement_noise = 1e-08  # rad²") == (1e-4, None)
    assert noise_in('measurement_noise = "0.01mrad"') == (1e-5, None)
    assert noise_in('measurement_noise = ["0.01mrad", "0.02mm", "0.01mrad"]') == (1e-5, 2e-5)


def test_where_a_pd_is_better_is_said(tmp_path: Path) -> None:
    own = {"lost": 0, "beyond": 0.05, "speed": 0.9, "back": 1.0, "hold": 0.5, "status": 4}
    followed = {"nominal": {"peak": 2e-3, "rms": 1e-3}, "corners": {"peak": 3e-3, "rms": 1e-3}}
    exact = followed | {"nominal": {"peak": 1e-3, "rms": 1e-4}}
    rows = {
        "stop": {"flexhinf": own | {"back": None}, "pd": own | {"beyond": 0.03}},
        "late": {"flexhinf": own, "pd": own},
        "eight": {"flexhinf": followed, "pd": exact},
        "design": {"met": True, "limits": {"remaining error": 5e-3}},
        "met": {
            law: {"moves": 2, "run": 2, "lost": 0, "remaining error": [1e-3, worst]}
            for law, worst in (("flexhinf", 4e-3), ("pd", 3e-3))
        },
    }
    (tmp_path / "scara.json").write_text(json.dumps(rows), encoding="utf-8")
    far, followed_by, oftener, nearer, sooner, rule, *_ = TABLES["short"](tmp_path).splitlines()[2:]
    assert re.findall(r"\d+", far) == ["2", "0", "5", "30", "50"]
    assert not re.findall(r"\d+", oftener)
    assert re.findall(r"\d+", nearer) == ["3", "4"]
    assert re.findall(r"\d+", sooner)[:2] == ["1", "2"]
    assert re.findall(r"\d+", sooner)[-2:] == ["1", "1"]
    assert re.findall(r"\d+", followed_by) == ["1", "2"]
    assert re.findall(r"\d+", rule)[:2] == ["1", "2"]


def test_no_kept_row_that_is_met_has_a_move_beyond_unsaid(repository: Path) -> None:
    """Each arm whose kept moves are beyond a limit of its design is named in docs/limits.md."""
    page = (repository / "docs" / "limits.md").read_text(encoding="utf-8")
    said = page.partition("## Met, and true")[2].partition("\n## ")[0]
    for name in ARMS:
        rows = kept(ROWS, name)
        run = rows.get("met", {}).get("flexhinf")
        if run and rows["design"]["met"] and beyond_limits(rows["design"]["limits"], run):
            assert f"`{name}`" in said, name


# Pushes ---------------------------------------------------------------------------------------------
def test_pushes_give_links_their_speeds_at_poses_that_motors_can_hold(elastic: Arm) -> None:
    """Of one joint 0.5 to 20 rad/s, of all down to 0.3 of that, on both sides; raised above hanging."""
    found = [*pushes_of(elastic, 12)]
    sizes = np.array([np.abs(push.speeds).max() for push in found])
    assert 0.15 <= sizes.min() < 2.0 < 7.0 < sizes.max() <= 20.0
    assert {np.sign(push.speeds[np.abs(push.speeds).argmax()]) for push in found} == {-1.0, 1.0}
    assert {np.count_nonzero(push.speeds) for push in found} == {1, elastic.n}
    poses = {push.where: push.pose for push in found}
    heights = [
        pin.computePotentialEnergy(elastic.model, elastic.memory, poses[at]) for at in ("raised", "hanging")
    ]
    assert heights[0] > heights[1]
    for push in found[:3]:
        assert np.all((push.pose >= elastic.lower) & (push.pose <= elastic.upper))
        plant = TrueArm(push.robot)
        plant.rest(push.pose)
        still = plant.read()[0]
        plant.push(push.speeds)
        plant.advance(push.robot.rest(push.pose)[1])
        assert plant.read()[0] - still == pytest.approx(PERIOD * push.speeds, rel=0.2, abs=0.2 * PERIOD)


def save_paper(folder: Path) -> Any:
    """The paper's arm, a controller of which is in the folder."""
    robot = robot_of("paper", None)
    design = fh.Specification(
        workspace="limits", measured=the_arms.MEASURED.split(","), peak_speed=2.0, saturation=48.0
    )
    setup = WorkspaceSetup(robot, design, workspace_of(robot, "limits"), ModalLaw.tuned(
        robot.problem(fh.Penalty({"link_position": 1.0})), PERIOD, PairWeights(bandwidth=7.0, share=0.7)
    ))  # fmt: skip
    setup.controller(np.zeros(1), supervision=setup.supervision).save(folder / "controller")
    return robot


@pytest.mark.ci("compiles two controllers of one joint")
def test_an_arm_that_is_pushed_is_judged_beside_its_law(tmp_path: Path) -> None:
    """From three pushes; of the rule each part is missed by a number that is changed."""
    robot = save_paper(tmp_path)
    arm, laws = Arm.of(robot), [Product(robot, tmp_path, governed) for governed in (True, False)]
    row = pushed(arm, *laws, count=3)["pushes"]
    assert [one["where"] for one in row] == ["raised", "hanging", "home"]
    assert all(returns(one) for one in row)
    assert all(len(one["stops"]) == 1 for one in row)
    for changed in ({"own": [1.2 * row[0]["law"][0], 0.5]}, {"own": [0.1, None]}, {"allowed": 0.0}):
        assert not returns(row[0] | changed)
    rows = {"pushes": {"flexhinf": {"pushes": row}}}
    (tmp_path / "paper.json").write_text(json.dumps(rows), encoding="utf-8")
    assert TABLES["pushes"](tmp_path).splitlines()[-1].startswith("| paper | 3 | 3 | 3 |")


@pytest.mark.ci("compiles two controllers of one joint")
def test_what_would_stop_an_arm_is_recorded_and_does_not_act(tmp_path: Path) -> None:
    """A start 0.2 rad off stops it at the first sample; its run is that of a controller without a protection. The
    protection knows the encoders that it is told."""
    save_paper(tmp_path)
    arm, law = Arm.of(robot_of("paper", None)), Product(robot_of("paper", None), tmp_path)
    watched, bare = law.told(step_of(arm, 13)), law.told(step_of(arm, 19))
    assert watched.controller.protection is not None
    assert watched.controller.protection.step == pytest.approx(step_of(arm, 13))
    bare.controller = bare.controller.fresh(protection=None)
    rows = [limits_of(arm, one, TRIALS["power-on"]) for one in (watched, bare)]
    assert rows[0]["stops"] == [[PERIOD, int(Reason.BAD_START)]]
    assert rows[1]["stops"] == [None]
    assert [rows[0][key] for key in ("beyond", "speed", "back")] == [
        rows[1][key] for key in ("beyond", "speed", "back")
    ]
    quiet = limits_of(arm, law.told(step_of(arm, 19)), FRAMES["repeated-3"])
    assert quiet["stops"] == [None, None]
    assert quiet["unseen"] == 3
    assert quiet["away"] < 2e-3


@pytest.mark.nightly("designs an arm and runs it: a kept row is what is measured again")
def test_a_row_is_measured_again_as_it_is_kept(tmp_path: Path) -> None:
    list(designed(tmp_path, PLANAR, None))
    bench = Bench(PLANAR, tmp_path / "rows", tmp_path, None)
    list(bench.make(["met", "brake-0.5"], ["flexhinf", "pd"]))
    for law in ("flexhinf", "pd"):
        old, new = (one["brake-0.5"][law] for one in (kept(ROWS, PLANAR), bench.data))
        assert new["beyond"] == pytest.approx(old["beyond"], rel=0.2, abs=2e-3)
    assert bench.data["design"]["met"]
    assert beyond_limits(bench.data["design"]["limits"], bench.data["met"]["flexhinf"]) == 0
