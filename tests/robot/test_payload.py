"""Payloads: part of their link in every plant, an uncertain mass, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from tests.builders import joint_text
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.plant import Parameters
from flexhinf.robot import Parameter, load_robot
from flexhinf.robot.arm import Payload, inertia_of_shape, payload_from_text
from flexhinf.robot.dynamics import lumped, matrix_of
from flexhinf.robot.parameters import check_parameters

ARM = joint_text(
    "slide", kind="prismatic", axis=[1, 0, 0], mass=2.0, centre=(0.1, 0.0, 0.0), inertia=(0.01, 0.02, 0.02),
    spring="stiffness = 1000.0", motor="motor_inertia = 1.5",
) + joint_text(
    "turn", axis=[0, 1, 0], xyz=[0.2, 0.0, 0.0], centre=(0.0, 0.1, 0.2), inertia=(0.02, 0.02, 0.01, 0.001),
    motor="motor_inertia = 0.2\nfriction = 0.3",
)  # fmt: skip

BOX = """
[[payload]]
at = "turn"
mass = { value = 1.0, range = [0.0, 3.0], source = "task" }
centre_of_mass = [0.0, 0.3, 0.1]
box = [0.1, 0.2, 0.3]
"""


def test_a_payload_is_part_of_its_link_at_any_mass(write):
    alone, loaded = load_robot(write(ARM)), load_robot(write(BOX + ARM))
    own, centre = alone.plant_parameters(), np.array([0.0, 0.3, 0.1])
    per_mass = np.diag([0.2**2 + 0.3**2, 0.1**2 + 0.3**2, 0.1**2 + 0.2**2]) / 12.0
    body = own["mass"][1], own["centre_of_mass"][1], matrix_of(own["inertia"][1])
    for mass, values in (
        (1.0, loaded.plant_parameters()),
        (3.0, loaded.corner({"payload_mass_turn": 1.0})),
        (0.5, loaded.corner({"payload_mass_turn": -0.5})),
    ):
        m, c, about = lumped([body, (mass, centre, mass * per_mass)])
        assert values["mass"][1] == pytest.approx(m, rel=1e-15)
        np.testing.assert_allclose(values["centre_of_mass"][1], c, rtol=1e-14)
        np.testing.assert_allclose(matrix_of(values["inertia"][1]), about, rtol=1e-14)
    empty = loaded.corner({"payload_mass_turn": -1.0})
    for name, value in own.items():
        np.testing.assert_array_equal(empty[name], value)


def test_the_mass_is_one_uncertain_number_of_draws_and_corners(write):
    robot = load_robot(write(BOX + ARM))
    assert [p.name for p in robot.uncertain] == ["payload_mass_turn"]
    assert robot["payload_mass_turn"].spread == "0 to 3"
    drawn = [robot.draw(np.random.default_rng(seed))["mass"][1] for seed in range(200)]
    assert 1.0 < min(drawn) < 1.1
    assert 3.9 < max(drawn) < 4.0
    assert robot.with_values({"payload_mass_turn": 2.0}).plant_parameters()["mass"][1] == 3.0
    with refused_with(InvalidInput, "range", "'payload_mass_turn'", "<= 5 <="):
        robot.with_values({"payload_mass_turn": 5.0})


@pytest.mark.oracle
def test_equal_to_pinocchio_with_the_payload_as_a_body_of_its_own(write, rigid, pinocchio_model):
    pin = pytest.importorskip("pinocchio")
    alone, loaded = load_robot(write(ARM)), load_robot(write(BOX + ARM))
    model = pinocchio_model(*rigid(alone))
    body = pin.Inertia(1.0, np.array([0.0, 0.3, 0.1]), np.diag([0.13, 0.1, 0.05]) / 12.0)
    model.appendBodyToJoint(2, body, pin.SE3.Identity())
    q, dq, ddq = np.random.default_rng(1).normal(size=(3, 2))
    expected = pin.rnea(model, model.createData(), q, dq, ddq)
    values = loaded.plant_parameters()
    plant = loaded.plant()
    found = loaded.links.torques(q, dq, ddq, plant.parameters.named(plant.parameters.vector()))
    np.testing.assert_allclose(np.array(found, dtype=float), expected, rtol=1e-12, atol=1e-12)
    assert values["mass"][1] == 2.0


URDF = """<robot name="r"><link name="base"/>
<joint name="a" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
 <limit lower="-2" upper="2" effort="9" velocity="3"/></joint>
<link name="arm"><inertial><origin xyz="0 0 0.2"/><mass value="2"/>
 <inertia ixx="0.02" iyy="0.02" izz="0.002" ixy="0" ixz="0.001" iyz="0"/></inertial></link>
<joint name="wrist" type="fixed"><parent link="arm"/><child link="hand"/>
 <origin xyz="0 0 0.5" rpy="0 1.5707963267948966 0"/></joint>
<link name="hand"/></robot>"""
ELASTIC = joint_text("a", mass=None)


def test_a_payload_at_a_link_of_a_urdf_is_seen_from_the_joint_that_carries_it(write):
    urdf = write(URDF, "r.urdf")
    robot = load_robot(urdf, elastic=write(ELASTIC), payload="0..1..3kg@hand:0.1,0,0")
    place = [robot[f"payload_centre_of_mass_{axis}"].value for axis in "xyz"]
    np.testing.assert_allclose(place, [0.0, 0.0, 0.4], atol=1e-15)
    assert robot["payload_mass"].interval == (0.0, 3.0)
    assert robot.nominal["payload_mass"] == 1.0
    tip = load_robot(urdf, elastic=write(ELASTIC), payload="2")
    assert tip.nominal["payload_centre_of_mass_z"] == 0.5
    assert tip.plant_parameters()["mass"] == [4.0]
    with refused_with(InvalidInput, "'hnd'", "'hand'"):
        load_robot(urdf, elastic=write(ELASTIC), payload="2@hnd")


def test_a_single_link_carries_at_twice_its_centre_of_mass_if_nothing_else_is_said():
    robot = load_robot("paper", payload="0..0.5kg")
    assert [robot.nominal[f"payload_centre_of_mass_{axis}"] for axis in "xyz"] == [2.0, 0.0, 0.0]
    whole = robot.corner({"payload_mass": 1.0})
    assert whole["mass"] == 1.5
    assert whole["mass"] * whole["length"] == pytest.approx(1.0 + 0.5 * 2.0)
    assert whole["link_inertia"] == pytest.approx(1.0 + 0.5 * 4.0)
    with refused_with(InvalidInput, "axis_inertia", "[0.5, 0.0]"):
        load_robot("paper", payload="1@joint:1,0.5,0")


def test_the_motors_hold_the_payload_at_the_tip():
    """A kilogram at the end of a stretched planar arm: m g times its lever about each joint."""
    loaded, bare = (load_robot("planar-two-link", payload=text) for text in ("1@elbow:0.4,0,0", None))
    pose = [np.pi / 2, 0.0]
    torques = [
        robot.links.gravity_torque(pose, Parameters(robot.plant_parameters())) for robot in (loaded, bare)
    ]
    np.testing.assert_allclose(torques[0] - torques[1], [9.81 * 0.9, 9.81 * 0.4], rtol=1e-12)


def test_tolerances_of_a_urdf_stand_in_the_elastic_file(write):
    urdf = write(URDF, "r.urdf")
    robot = load_robot(
        urdf,
        elastic=write(
            "[tolerances]\nmass = 5\nstiffness = 12\nmotor_inertia = 3\ninertia = 4\n"
            + ELASTIC
            + "[joint.tolerances]\nmass = 10\ncentre_of_mass = 2\n"
        ),
    )
    tolerances = {p.name: p.tolerance for p in robot.uncertain}
    assert tolerances == {
        "mass": 10.0, "centre_of_mass_z": 2.0, "stiffness": 12.0, "motor_inertia": 3.0, "inertia_scale": 4.0,
    }  # fmt: skip
    assert robot["mass"].source == "r.urdf"
    high = robot.corner({"inertia_scale": 1.0, "mass": -1.0})
    np.testing.assert_allclose(high["inertia"], 1.04 * robot.plant_parameters()["inertia"], rtol=1e-15)
    assert high["mass"] == [1.8]


def test_a_number_keeps_its_own_tolerance_and_an_unused_one_is_refused(write):
    stated = "[tolerances]\nstiffness = 12\nmass = 2\n" + ARM.replace(
        "stiffness = 100.0", "stiffness = { value = 100.0, tolerance = 0 }"
    )
    robot = load_robot(write(stated))
    assert {p.name for p in robot.uncertain} == {"stiffness_slide", "mass_slide", "mass_turn"}
    with refused_with(InvalidInput, "[tolerances]", "'coulomb_friction'", "joint"):
        load_robot(write("[tolerances]\ncoulomb_friction = 5\n" + ARM))
    with refused_with(InvalidInput, "'turn'", "'backlash'"):
        load_robot(write(ARM + "[joint.tolerances]\nbacklash = 5\n"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("three", "LOWER"),
        ("3lb", "LOWER"),
        ("0..1..2..3", "LOWER"),
        ("1@turn:1,2", "LOWER"),
        ("nan", "LOWER"),
        ("1_0", "LOWER"),
        ("1@", "LOWER"),
        pytest.param(f"1@{' ' * 20_000}:", "LOWER", id="spaces"),
        ("1e-320", r"mass[\s\S]* 9.99989e-321"),
        ("-1..2", r"mass[\s\S]* -1 to 2 kg"),
        ("3..0", r"'mass'[\s\S]*<= 3 <="),
        ("1@elbow", r"'elbow'[\s\S]*'slide', 'turn'"),
        (1.0, r"Payload[\s\S]* 1\.0"),
        (b"1kg", r"Payload[\s\S]* b'1kg'"),
        ({"mass": 1.0}, r"Payload[\s\S]* {'mass': 1\.0}"),
        ([None], r"Payload[\s\S]* \[None\]"),
    ],
)
def test_what_is_no_payload_is_refused(write, text, message):
    with pytest.raises(InvalidInput, match=message):
        load_robot(write(ARM), payload=text)


@pytest.mark.parametrize("text", ["0", "0kg@turn", "0..0kg"])
def test_no_mass_is_an_empty_hand(write, text):
    bare, empty = load_robot(write(ARM)), load_robot(write(ARM + BOX), payload=text)
    assert empty["payload_mass_turn"].value == 0.0
    assert not empty.uncertain
    vectors = [robot.plant().parameters.vector() for robot in (bare, empty)]
    np.testing.assert_array_equal(*vectors)


def test_a_range_holds_its_value_and_replaces_a_tolerance():
    with refused_with(InvalidInput, "range", "'mass'", "<= 4 <="):
        Parameter("mass", 4.0, range=(0.0, 3.0))
    with refused_with(InvalidInput, "'mass'", "tolerance", "range"):
        Parameter("mass", 1.0, 5.0, range=(0.0, 3.0))
    one = Parameter("mass", 1.0, range=(0.0, 3.0))
    assert [one.at(sign) for sign in (-1.0, -0.5, 0.0, 0.5, 1.0)] == [0.0, 0.5, 1.0, 2.0, 3.0]


def test_shapes_are_uniform_bodies():
    assert inertia_of_shape("sphere", [0.1]) == pytest.approx((0.004, 0, 0, 0.004, 0, 0.004))
    thin = inertia_of_shape("cylinder", [1e-9, 0.6])
    assert thin == pytest.approx((0.03, 0, 0, 0.03, 0, 0))
    with refused_with(InvalidInput, "box", "[0.1, 0.0, 0.1]"):
        inertia_of_shape("box", [0.1, 0.0, 0.1])
    with refused_with(InvalidInput, "inertia", "[0.1, 0.1, 1.0]"):
        Payload(Parameter("mass", 1.0), inertia_per_mass=(1.0, 0, 0, 0.1, 0, 0.1))
    assert payload_from_text(" 2 kg @ hand ").at == "hand"
    check_parameters("r", [Parameter("payload_mass_a", 1.0)], {"a": False, "b": False})
