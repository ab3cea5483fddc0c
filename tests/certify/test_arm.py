"""Arms of certificates: at every pose, against random robots, at the edge of what is true, forged, damaged."""

import copy
import json
from dataclasses import replace
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmarks.workspace import masses
from benchmarks.workspace.robots import ROBOTS
from flint import arb, ctx

from flexhinf.certify.checker import arm as checker
from flexhinf.certify.checker.arm import CheckedArm, arm_claim, check_arm, weights_of
from flexhinf.certify.checker.pairs import CheckedPairs
from flexhinf.designs import Specification
from flexhinf.designs.responses import with_values
from flexhinf.designs.workspace import everywhere as everywhere_file, proof
from flexhinf.designs.workspace.everywhere import everywhere, file_errors
from flexhinf.designs.workspace.masses import stated_errors
from flexhinf.designs.workspace.search import RANDOM
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.errors import InvalidInput
from flexhinf.modal.pair_errors import Sector
from flexhinf.plant.joints import link_compliance
from flexhinf.robot.workspace import workspace_of

WIDE = Sector(0.5, 0.4)


def setup_of(name):
    robot = ROBOTS[name].robot()
    law, _ = masses.pairs_of(robot)
    return WorkspaceSetup(robot, Specification(), workspace_of(robot), law, RANDOM[0])


@pytest.fixture(scope="module")
def setups():
    """A plane arm with tolerances of all that its inertia depends on; one in space that carries up to 0.3 kg."""
    carries = replace(ROBOTS["spatial"], payload="0..0.3kg").robot(payload=True)
    return {
        "planar-two-link": setup_of("planar-two-link"),
        "spatial": replace(setup_of("spatial"), other=carries),
    }


@pytest.fixture(scope="module")
def found(setups):
    return {name: everywhere(setup, WIDE, setup.gains.ends) for name, setup in setups.items()}


def inertia(plant, pose):
    return np.linalg.inv(link_compliance(plant).matrix(pose, plant.parameters.vector()))


@pytest.mark.oracle
@pytest.mark.ci("many robots at many poses")
@pytest.mark.parametrize("name", ["planar-two-link", "spatial"])
def test_robots_and_poses_that_nobody_looked_at_are_within_what_is_shown(setups, found, name):
    """By the plant's own equations: inertia matrices of corners and between them, and λ; some come near the ends."""
    setup, (_, shown), rng = setups[name], found[name], np.random.default_rng(4)
    assert isinstance(shown, CheckedArm)
    robot, ends, links = setup.true.robot, [0.0, 0.0], []
    names = [p.name for p in robot.uncertain]
    places = [*rng.uniform(-1.0, 1.0, (10, len(names))), *rng.choice([-1.0, 1.0], (24, len(names)))]
    places += [np.full(len(names), sign) for sign in (-1.0, 1.0)]
    plants = [with_values(setup.true_plant, robot.corner(dict(zip(names, place)))) for place in places]
    root = np.sqrt(setup.law.joints.stiffness)
    for pose in setup.workspace.sample(12, 77):
        own = inertia(setup.law.plant, pose)
        links += np.linalg.eigvalsh(root[:, None] * np.linalg.inv(own) * root).tolist()
        for plant in plants:
            errors = np.linalg.eigvals(own @ np.linalg.inv(inertia(plant, pose))).real - 1.0
            ends = [max(ends[0], -errors.min()), max(ends[1], errors.max())]
    assert ends[0] <= shown.lower
    assert ends[1] <= shown.upper
    assert shown.low <= min(links)
    assert max(links) <= shown.high
    if name == "planar-two-link":  # without a payload the smallest sector is stated
        assert ends[0] > 0.8 * shown.lower
        assert ends[1] > 0.8 * shown.upper


@pytest.mark.oracle
@pytest.mark.costs("the laws of two robots")
def test_the_checker_s_inertia_matrix_is_that_of_the_plant(setups, found):
    """A trigonometric polynomial in balls, at random poses; also of joints that slide."""
    scara = setup_of("scara")
    for setup, shown in ((setups["spatial"], found["spatial"]), (scara, everywhere(scara, WIDE, (1e3, 1e7)))):
        assert shown is not None
        claim = arm_claim(shown.arm)
        own = [
            (b.mass[0], checker.column([x[0] for x in b.centre]), checker.inertia_of(b)) for b in claim.bodies
        ]
        with ctx.workprec(106):
            cover = checker.Cover(claim.joints, checker.polynomial(claim.joints, list(enumerate(own))))
            for pose in setup.workspace.sample(5, 3):
                low, high = np.array([joint.ends for joint in claim.joints]).T
                slides = np.array([joint.slides for joint in claim.joints])
                place = np.where(slides, (2.0 * pose - low - high) / (high - low), pose)
                value, _ = cover.at([arb(place[k]) for k in cover.free])
                matrix = np.array([[float(entry) for entry in row] for row in value.tolist()])
                np.testing.assert_allclose(matrix, inertia(setup.law.plant, pose), atol=1e-12)


@pytest.mark.oracle
@pytest.mark.costs("the laws of three robots")
def test_gravity_changes_no_faster_than_is_shown_at_any_pose(setups, found):
    """By differences of the plant's torques at rest, of robots with their masses at their largest; none where all axes
    that turn are upright."""
    for name, setup in (*setups.items(), ("scara", setup_of("scara"))):
        shown = found[name] if name in found else everywhere(setup, WIDE, (1e3, 1e7))
        assert shown is not None
        robot, root = setup.true.robot, np.sqrt(setup.law.joints.stiffness)
        heavy = {p.name: p.interval[1] for p in robot.uncertain if "mass" in p.name}
        plant = with_values(setup.true_plant, robot.varied(heavy))
        numbers, largest = plant.parameters.named(plant.parameters.vector()), 0.0
        for pose in setup.workspace.sample(25, 9):
            slope = np.array(
                [
                    (
                        robot.links.gravity_torque(pose + step, numbers)
                        - robot.links.gravity_torque(pose - step, numbers)
                    )
                    / 2e-6
                    for step in 1e-6 * np.eye(len(pose))
                ]
            ).astype(float)
            largest = max(largest, np.abs(np.linalg.eigvals(slope / np.outer(root, root))).max())
        assert largest <= shown.checked.slope * (1.0 + 1e-6) + 1e-9
        assert largest >= 0.5 * shown.checked.slope
        assert (shown.checked.slope == 0.0) == (name == "scara")


def test_bodies_are_compared_once_for_what_is_stated_and_what_is_shown(setups, monkeypatch):
    setup, compared = replace(setups["planar-two-link"]), list[Any]()
    sector_of = everywhere_file._body_sector
    monkeypatch.setattr(
        everywhere_file, "_body_sector", lambda body: compared.append(body) or sector_of(body)
    )
    assert file_errors(setup).slope_poses == 0
    assert everywhere(setup, Sector(0.0, 0.0), setup.gains.ends) is None  # what is proved is too little
    assert len(compared) == 2


@pytest.mark.costs("the laws of two robots")
@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize("name", ["planar-two-link", "spatial"])
def test_a_range_is_shown_just_where_it_is_true(setups, found, name, end):
    """The slowest and the fastest vibration, by a search over poses: 1 % beyond is shown, 1 % short of it is not."""
    setup = setups[name]
    root, (low, high) = np.sqrt(setup.law.joints.stiffness), (setup.workspace.lower, setup.workspace.upper)
    poses, size = setup.workspace.sample(300, 5), 0.2
    for seed in range(8):  # ever nearer to the pose that is worst so far
        turned = [np.linalg.inv(inertia(setup.law.plant, pose)) for pose in poses]
        ends = np.linalg.eigvalsh(root[:, None] * np.array(turned) * root)[:, -end]
        worst = poses[int(np.argmax(ends) if end else np.argmin(ends))]
        poses = np.clip(worst + size * np.random.default_rng(seed).normal(size=(40, len(low))), low, high)
        poses[0], size = worst, 0.5 * size
    extreme = float(max(ends) if end else min(ends))
    for factor, shown in ((1.01, True), (0.99, False)):
        ends = list(setup.gains.ends)
        ends[end] = extreme * (factor if end else 1.0 / factor)
        assert isinstance(check_arm(arm_claim({**found[name].arm, "range": ends})), CheckedArm) == shown


@pytest.mark.parametrize(
    ("index", "factor", "ends", "least"),
    [
        (1, 1.0, (-1.0, 1.0), np.cos(1.0)),
        (2, 1.0, (0.2, np.pi - 0.2), np.sin(0.2)),
        (3, 1.0, (-0.5, 0.5), np.cos(1.0)),
        (4, 1.0, (0.1, 0.5 * np.pi - 0.1), np.sin(0.2)),
        (2, -1.0, None, -1.0),  # −x² of a joint that slides
    ],
)
def test_what_falls_below_zero_only_at_the_ends_is_not_shown(index, factor, ends, least):
    """A number that is largest, without a slope, in the middle."""
    zero = checker.column([arb(0)] * 3)
    joint = checker.ArmJoint(0, ends is None, zero, zero, zero, ends or (0.0, 1.0), arb(1))
    for more, shown in ((1e-3, True), (-1e-3, False)):
        terms = {(0,): checker.column([arb(more - least)]), (index,): checker.column([arb(factor)])}
        assert (checker.Cover([joint], terms).boxes is not None) == shown


@pytest.mark.costs("the laws of two robots")
def test_on_a_box_that_is_shown_no_pose_is_worse(found):
    """Random boxes, and poses in them, of an arm that has slower and faster vibrations than the range at some poses."""
    low, high = found["spatial"].arm["range"]
    claim, rng, shown = (
        arm_claim({**found["spatial"].arm, "range": [2.0 * low, 0.5 * high]}),
        np.random.default_rng(2),
        0,
    )
    with ctx.workprec(106):
        for _, terms in list(checker.inequalities(claim))[-2:]:
            cover = checker.Cover(claim.joints, terms)
            for _ in range(150):
                centre, half = rng.uniform(-2.0, 2.0, 2), rng.uniform(0.05, 0.5, 2)
                if cover.split([*zip((centre - half).tolist(), (centre + half).tolist())]) != -1:
                    continue
                shown += 1
                for signs in (*product((-1.0, 1.0), repeat=2), *rng.uniform(-1.0, 1.0, (6, 2))):
                    value, _ = cover.at([arb(x) for x in (centre + half * signs).tolist()])
                    rows = [[float(entry) for entry in row] for row in value.tolist()]
                    assert np.linalg.eigvalsh(rows)[0] > 0.0
    assert 20 < shown < 280


@pytest.mark.ci("a law with a payload, and boxes of its poses")
def test_a_payload_is_shown_just_where_it_is_true(setups, found):
    """Against the worst robots that are sought in 200 poses, which a search begins with."""
    setup = setups["spatial"]
    sampled = stated_errors(setup).errors.masses
    lower, near = sampled.lower, everywhere(setup, WIDE, setup.gains.ends, sampled)
    assert near is not None
    assert lower < near.checked.lower < 1.06 * lower
    for factor, shown in ((1.06, True), (0.99, False)):
        claim = arm_claim({**found["spatial"].arm, "lower": factor * lower})
        assert isinstance(check_arm(claim), CheckedArm) == shown


#: Ways in which a file may say more than is true of its arm: what is changed, and by which factors.
FORGED = [
    ("lower", (0.3, 0.9)),
    ("upper", (0.2, 0.9)),
    ("range", (0.3, 0.9)),
    ("mass", (1.1, 3.0)),
    ("centre", (1.1, 2.0)),
    ("inertia", (1.2, 3.0)),
    ("scale", (1.2, 3.0)),
    ("payload", (4.0, 9.0)),
    ("stiffness", (4.0, 30.0)),
    ("translation", (3.0, 9.0)),
    ("split", (3.0, 1e3)),
    ("no split", (1e-9, 1e-6)),
    ("slope", (0.3, 0.8)),
    ("gravity", (1.5, 4.0)),
]


def forged(arm: Any, name: str, factor: float, rng: np.random.Generator) -> Any:
    file = copy.deepcopy(arm)
    body, joint = file["bodies"][int(rng.integers(len(file["bodies"])))], file["joints"][-1]
    if name in ("lower", "upper"):
        file[name] *= factor
        file[f"bodies_{name}"] = min(file[name], factor * file[f"bodies_{name}"])
    elif name == "slope":
        file["slope"] *= factor
    elif name == "gravity":
        file["gravity"] = [factor * entry for entry in file["gravity"]]
    elif name == "range":
        end = int(rng.integers(2))
        file["range"][end] *= 0.55 * factor if end else 2.5 / factor
    elif name == "mass":
        body["mass"][2] *= factor
    elif name == "centre":
        entry = max(body["centre"], key=lambda entry: abs(entry[0]))
        entry[1:] = sorted([entry[0], factor * entry[0]])
    elif name == "inertia":
        body["inertia"][int(rng.choice([0, 3, 5]))][2] *= factor
    elif name == "scale":
        body["scale"][2] *= factor
    elif name == "payload":
        file["payloads"][0]["mass"][2] *= factor
    elif name == "stiffness":
        joint["stiffness"] *= factor
    elif name == "translation":
        joint["translation"] = [factor * entry for entry in joint["translation"]]
    else:
        body["split"] = min(0.9, factor * body["split"])
    return file


@pytest.mark.costs("the laws of two robots")
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("name", ["planar-two-link", "spatial"])
def test_none_of_a_hundred_forged_and_damaged_arms_is_accepted(found, name):
    arm, rng = json.loads(json.dumps(found[name].arm)), np.random.default_rng(6)
    assert isinstance(check_arm(arm_claim(arm)), CheckedArm)
    # One has no payload, and the centres of mass of the other are exact.
    left_out = ["payload"] if name == "planar-two-link" else ["split", "no split"]
    for kind, (low, high) in FORGED:
        for _ in range(5 * (kind not in left_out)):
            file = forged(arm, kind, float(rng.uniform(low, high)), rng)
            assert isinstance(check_arm(arm_claim(file)), str), kind
    wrong = [None, "text", [], {}, True, float("nan"), float("inf"), -1.0, [[1.0], [2.0, 3.0]]]
    for _ in range(50):
        file = copy.deepcopy(arm)
        part = [file, file["joints"][1], file["bodies"][0]][int(rng.integers(3))]
        key = str(
            rng.choice(sorted(set(part) - {"payloads", "parent", "slides", "range", "slope", "moment"}))
        )
        part[key] = wrong[int(rng.integers(len(wrong)))]
        with pytest.raises(InvalidInput, match="certificate"):
            arm_claim(file)


@pytest.mark.costs("the laws of two robots")
@pytest.mark.parametrize("part", ["moment", "rotation", "axis"])
def test_what_bounds_of_gravity_rely_on_is_asked_of_a_file(found, part):
    """A moment stands for the mass of a single joint alone; frames turn, and axes are of length 1."""
    file = json.loads(json.dumps(found["planar-two-link"].arm))
    if part == "moment":
        file["bodies"][1]["moment"] = [0.0, 0.0, 0.0]
    else:
        joint = file["joints"][1]
        joint[part] = (0.9 * np.array(joint[part])).tolist()
    with pytest.raises(InvalidInput, match="certificate"):
        arm_claim(file)


@pytest.mark.costs("the laws of two robots")
def test_bounds_of_gravity_hold_the_model_with_which_a_filter_predicts(found):
    """It may be heavier than all robots of a file."""
    claim, heavy = arm_claim(found["spatial"].arm), (arb(20), arb(1), arb(2))
    body = claim.bodies[0]
    single = body._replace(mass=heavy, moment=(arb(7), arb(1), arb(2)))
    load = claim.payloads[0]._replace(mass=heavy)
    claim = claim._replace(bodies=(body._replace(mass=heavy), single), payloads=(load,))
    masses, moments = zip(*((float(one.mass), float(one.moment)) for one in weights_of(claim)))
    assert masses == (20.0, 0.0, 20.0)
    assert moments[1] == 7.0


@pytest.mark.costs("the laws of two robots")
def test_large_motions_are_of_one_joint_whose_gravity_is_shown(found, monkeypatch):
    """A file says of them only beside an arm of one joint; an arm of two, or none, is more than the certificate."""
    pairs = CheckedPairs(1.0, 1e9, 0.9, 9.0, 0.0, 0.0, 9.0, 9.0, 0.0, True, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1)
    monkeypatch.setattr(proof, "pair_claim", lambda numbers: SimpleNamespace(seen=None))
    monkeypatch.setattr(proof, "check_pairs", lambda claim, every: pairs)
    arm = found["planar-two-link"].arm
    for numbers in ({}, {"arm": arm}):
        assert proof.pair_verdict({"pairs": {}, "proved": pairs._asdict(), **numbers}).beyond
    shown = found["planar-two-link"].checked
    assert proof._is_single_joint(shown._replace(joints=1), pairs)
    assert not proof._is_single_joint(shown._replace(joints=1, slope=None), pairs)
    assert not proof._is_single_joint(shown._replace(joints=1, slope=10.0), pairs)
