"""MJCF files: the same robot as MuJoCo's, with the elastic data beside it; and what is refused."""

from __future__ import annotations

import pathlib
import re
import sys
import warnings

import numpy as np
import pytest
from tests.builders import joint_text
from tests.refusals import refused_with, unnamed

from flexhinf.errors import InvalidInput
from flexhinf.robot import RobotFileWarning, load_robot
from flexhinf.robot.dynamics import Tree, bodies_of, inverse_dynamics, mass_matrix
from flexhinf.robot.mjcf import read_mjcf
from flexhinf.validation import read_xml

ARM = """
<mujoco model="own">
  <compiler angle="degree" eulerseq="XYz"/>
  <option gravity="0.5 0 -9.7"/>
  <default>
    <joint damping="0.4" armature="0.02"/>
    <default class="heavy"><joint armature="0.3" frictionloss="0.7" range="-100 120"/>
      <default class="slow"><joint damping="2"/></default></default>
    <default class="drawn"><geom mass="0" type="mesh"/></default>
  </default>
  <worldbody>
    <light pos="0 0 3"/><geom type="plane" size="1 1 1"/>
    <body name="column" pos="0.1 0 0.2" euler="20 -30 40">
      <inertial pos="0 0 0.1" mass="9" diaginertia="0.1 0.1 0.1"/>
      <body name="upper" pos="0 0.05 0.3" quat="0.9 0.1 -0.3 0.2" childclass="heavy">
        <joint name="shoulder" axis="0.1 1 0" pos="0.01 -0.02 0.03" ref="15"/>
        <inertial pos="0.02 0 0.2" quat="0.8 0.1 0.5 0.2" mass="2.5" diaginertia="0.03 0.028 0.004"/>
        <geom class="drawn" mesh="upper"/>
        <site name="mark" pos="0 0 0.1"/>
        <body name="fore" pos="0 0 0.4" axisangle="1 0 1 70">
          <joint name="elbow" class="slow" range="-90 45"/>
          <inertial pos="0 0.1 0" mass="1.5" diaginertia="0.02 0.004 0.021"/>
          <body name="tool" pos="0 0.3 0" zaxis="1 1 0.2">
            <inertial pos="0 0 0.05" mass="0.4" diaginertia="0.001 0.001 0.0005"/>
            <frame pos="0 0 0.1" euler="0 0 90">
              <body name="left" pos="0.02 0 0" xyaxes="0 1 0 -1 0 0.1">
                <joint name="finger" type="slide" axis="1 0 0" range="0 0.04" armature="0" damping="0"/>
                <inertial pos="0 0 0.02" mass="0.1" diaginertia="1e-4 1e-4 5e-5"/>
              </body>
            </frame>
            <body name="right" pos="-0.02 0 0">
              <joint name="other" type="slide" axis="-1 0 0" range="0 0.04" ref="0.01"/>
              <inertial pos="0 0.01 0.02" mass="0.12" diaginertia="1e-4 1e-4 5e-5"/>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="shoulder" ctrlrange="-2 2" gear="40"/>
    <position joint="elbow" kp="100" forcerange="-12 12"/>
  </actuator>
</mujoco>
"""

SHAPES = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="a"><joint name="a" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0.1 0.05 0.4" size="0.04"/>
    <geom type="sphere" size="0.06" pos="0 0.1 0" mass="0.7"/>
    <body name="b" pos="0.1 0.05 0.4"><joint name="b" axis="1 0 0" pos="0 0 0.01"/>
      <geom type="box" size="0.03 0.05 0.2" pos="0 0 0.2" euler="0.3 0.2 0.1" density="700"/>
      <geom type="cylinder" size="0.02 0.1" pos="0 0.1 0.4" axisangle="0 1 0 0.7"/>
      <geom type="ellipsoid" size="0.02 0.03 0.05" pos="0 0 0.5"/>
      <frame pos="0 0 0.1" quat="1 1 0 0"><geom type="sphere" size="0.02" pos="0.1 0 0"/></frame>
    </body>
  </body></worldbody></mujoco>
"""

JOINTS = "name = 'own'\nlocked = { finger = 0.03, other = 0.0 }\n" + "".join(
    f"[[joint]]\nname = '{joint}'\n[joint.spring]\nstiffness = {stiffness}\n"
    for joint, stiffness in (("shoulder", 900.0), ("elbow", 500.0))
)


def rigid(path, locked=None):
    return read_mjcf(read_xml(path), None, locked)


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("text", "locked", "accuracy"),
    [(ARM, {}, 1e-12), (ARM, {"elbow": 0.4, "finger": 0.02}, 1e-12), (SHAPES, {}, 1e-10)],
)
def test_mass_matrix_and_bias_forces_are_mujocos(write, text, locked, accuracy):
    mujoco = pytest.importorskip("mujoco")
    arm = rigid(write(text), locked)
    model = mujoco.MjModel.from_xml_string(text.replace('<geom class="drawn" mesh="upper"/>', ""))
    data, rng = mujoco.MjData(model), np.random.default_rng(3)
    tree, names = Tree(arm.joints), [joint.name for joint in arm.joints]
    bodies = bodies_of(tree, *zip(*((link.mass, link.centre_of_mass, link.inertia) for link in arm.links)))
    place = np.array([model.joint(name).qposadr[0] for name in names])
    size, direction = arm.gravity, np.array(arm.down)
    for _ in range(10):
        q, dq = rng.normal(size=(2, len(names)))
        data.qpos[place], data.qvel[place] = q, dq
        for name, value in locked.items():
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full) if mujoco.__version__ >= "3.9" else mujoco.mj_fullM(
            model, full, data.qM
        )
        expected = (full - np.diag(model.dof_armature))[np.ix_(place, place)]
        found = np.array(mass_matrix(tree, bodies, q), dtype=float)
        np.testing.assert_allclose(found, expected, atol=accuracy * np.abs(expected).max())
        bias = inverse_dynamics(tree, bodies, q, dq, np.zeros(len(names)), tuple(size * direction))
        weight = np.abs(data.qfrc_bias[place])
        np.testing.assert_allclose(
            np.array(bias, dtype=float), data.qfrc_bias[place], atol=accuracy * weight.max()
        )


def test_motors_limits_and_gravity_are_those_of_the_file(write):
    robot = load_robot(write(ARM), elastic=write(JOINTS, "joints.toml"))
    assert robot.joint_names == ("shoulder", "elbow")
    nominal = robot.nominal
    assert (nominal["motor_inertia_shoulder"], nominal["friction_shoulder"]) == (0.3, 0.4)
    assert (nominal["friction_elbow"], nominal["coulomb_friction_elbow"]) == (2.0, 0.7)
    assert robot["motor_inertia_elbow"].source == "arm.xml"
    assert robot.effort_limits == (80.0, 12.0)
    np.testing.assert_allclose(robot.links.limits, np.deg2rad([[-100, 120], [-90, 45]]))
    assert nominal["gravity"] == pytest.approx(np.hypot(0.5, 9.7))
    table = "mjcf = 'arm.xml'\ngravity = 9.81\ndown = [0, 0, -1]\n" + JOINTS.replace(
        "stiffness = 500.0\n", "stiffness = 500.0\n[joint.motor]\nrotor_inertia = 1e-5\ngear_ratio = 100\n"
    )
    other = load_robot(write(table, "whole.toml"), payload="0..1kg@left")
    assert other.plant_parameters()["motor_inertia"] == pytest.approx([0.3, 0.1])
    assert other.nominal["gravity"] == 9.81
    assert other["payload_mass_elbow"].interval == (0.0, 1.0)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<option", "<include file='x.xml'/><option", "<include>"),
        ('type="slide" axis="1 0 0"', 'type="ball"', "'finger'.*'ball'"),
        ('type="slide" axis="1 0 0"', 'type="slide" axis="1 x 0"', "attribute 'axis'"),
        ('name="elbow"', 'name="elbow" stiffness="3"', r"'elbow'.*stiffness[\s\S]*\[3\."),
        ('name="elbow"', 'name="elbow" axs="0 0 1"', "attribute: 'axs'"),
        ('name="elbow"', "", r"joint[\s\S]*printable.*''"),
        ('name="elbow"', 'name="shoulder"', "repeated name 'shoulder'"),
        ('class="slow"', 'class="slw"', "name 'slow'"),
        ("<actuator>", "<equality><joint joint1='finger' joint2='other'/></equality><actuator>", "couples"),
        ("<actuator>", "<tendon><fixed stiffness='3'><joint joint='elbow' coef='1'/></fixed></tendon><actuator>",
         "tendon.*stiffness"),
        ("<actuator>", "<default><tendon stiffness='3'/></default>"
         "<tendon><fixed><joint joint='elbow' coef='1'/></fixed></tendon><actuator>", "tendon.*stiffness"),
        ('diaginertia="0.02 0.004 0.021"', "", r"'fore'.*incomplete"),
        ('mass="0.4"', 'mass="-0.4"', r"mass.*<inertial>[\s\S]*'-0\.4'"),
        ('armature="0.02"', 'armature="1e31"', r"armature.*<joint>[\s\S]*'1e31'"),
        ('diaginertia="0.02 0.004 0.021"', 'diaginertia="0.02 0.004 0.9"', r"inertia.*A \+ B >= C"),
        ('pos="0 0 0.4" axisangle="1 0 1 70"', 'pos="0 0 x"', "attribute 'pos'"),
        ('axisangle="1 0 1 70"', 'axisangle="1 0 1 70" euler="0 0 0"', "orientation"),
        ('eulerseq="XYz"', 'eulerseq="XYz" settotalmass="3"', "settotalmass"),
        ('gravity="0.5 0 -9.7"', 'density="1000"', "medium"),
        ('<inertial pos="0 0.1 0" mass="1.5" diaginertia="0.02 0.004 0.021"/>', '<geom type="mesh" mesh="m"/>',
         r"mass.*'fore'[\s\S]*'mesh'"),
        ('<joint name="elbow" class="slow" range="-90 45"/>',
         '<joint name="elbow"/><joint name="twist" axis="1 0 0"/>', "'fore'.* 2 joints"),
        ('class="drawn"', 'class="slow"', "Element 'default'"),
        ('name="fore"', 'name="upper"', "repeated name 'upper'"),
        ('name="fore"', 'name="&#x202e;"', r"body[\s\S]*printable.*'\\u202e'"),
        ("<worldbody>", '<worldbody><joint name="base"/>', "World body"),
        ('<option gravity="0.5 0 -9.7"/>', '<option><flag damper="disable"/></option>', "flag.*damping"),
        ('range="-90 45"', 'range="45 -90"', r" range.*'elbow'[\s\S]* 45 to -90"),
        ('range="-90 45"', 'range="-90 45" limited="perhaps"', "keyword: 'perhaps'"),
        ('axis="0.1 1 0"', 'axis="0.1 1 0" actuatorfrcrange="3 1"', r"actfrcrange.*'shoulder'[\s\S]* 3 to 1"),
        ('forcerange="-12 12"', 'forcerange="12 -12"', r"forcerange.*'elbow'[\s\S]* 12 to -12"),
    ],
)  # fmt: skip
def test_what_is_not_read_and_would_change_the_dynamics_is_refused(write, old, new, words):
    assert old in ARM
    with pytest.raises(InvalidInput, match=words):
        rigid(write(ARM.replace(old, new, 1)))


def test_a_limit_that_is_switched_off_is_none(write):
    switched = ARM.replace('forcerange="-12 12"', 'forcerange="-12 12" forcelimited="false"')
    assert np.isfinite(rigid(write(ARM)).efforts[1])
    assert np.isinf(rigid(write(switched)).efforts[1])


def test_wrong_names_and_missing_elastic_data_are_refused(write):
    path = write(ARM)
    for joints, locked, words in (
        (["elbow"], {"elbow": 0.1}, "'elbow'.*chosen.*locked"),
        (["elbw"], {}, r"'elbw'(.|\n)*try:   'elbow'"),
        (None, {"elbow": 2.0}, r"'elbow'.*limits(.|\n)*-1\.5708 to 0\.785398, got 2"),
    ):
        with pytest.raises(InvalidInput, match=words):
            read_mjcf(read_xml(write(ARM)), joints, locked)
    with refused_with(InvalidInput, "arm.xml", "'elbw'"):
        load_robot(path, elastic=write(JOINTS, "joints.toml"), joints=["elbw"])
    with refused_with(InvalidInput, "arm.xml", "elastic="):
        load_robot(path)
    with refused_with(InvalidInput, "URDF", "<sdf>", "MJCF"):
        load_robot(write("<sdf/>"), elastic=write(JOINTS, "joints.toml"))
    with refused_with(InvalidInput, "none.toml'", "catalogue"):
        load_robot(path, elastic=path.with_name("none.toml"))


def test_without_mujoco_an_error_names_the_extra(write, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with refused_with(InvalidInput, "flexhinf[mujoco]"):
        rigid(write(ARM))


def test_no_other_file_is_opened_and_none_is_written(write, monkeypatch, tmp_path):
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    asset = (
        '<asset><mesh name="upper" file="none.stl"/><texture file="none.png" type="2d"/></asset><worldbody>'
    )
    assert len(rigid(write(ARM.replace("<worldbody>", asset))).joints) == 4
    for word in ("nan", "-inf"):
        with pytest.raises(InvalidInput, match=f"axis.*<joint>(.|\\n)*'{word} 0 0'"):
            rigid(write(ARM.replace('axis="1 0 0"', f'axis="{word} 0 0"')))
    assert [path.name for path in tmp_path.iterdir()] == ["arm.xml"]


TWO = """<mujoco><compiler angle="radian"/>
<default><default class="big"><general gainprm="4500" biastype="affine" biasprm="0 -4500 -450" forcerange="-87 87"/>
</default></default>
<worldbody><body name="A"><joint name="a" axis="0 1 0" range="-2 2"/>
<inertial pos="0 0 -0.15" mass="1" diaginertia="0.02 0.02 0.004"/>
<body name="B" pos="0 0 -0.3"><joint name="b" axis="0 1 0" range="-2 2"/>
<inertial pos="0 0 -0.15" mass="0.5" diaginertia="0.01 0.01 0.002"/></body></body></worldbody>
<tendon><fixed name="rope"><joint joint="b" coef="1"/></fixed></tendon>
<actuator>{}</actuator></mujoco>"""
BOTH = "".join(
    joint_text(name, mass=None, spring="stiffness = 400.0", motor="motor_inertia = 0.2") for name in "ab"
)


@pytest.mark.parametrize(
    ("actuators", "efforts"),
    [
        (
            '<general class="big" joint="a"/><general class="big" joint="b" ctrlrange="-2.5 2.5"/>',
            (87.0, 87.0),
        ),
        ('<motor joint="a" ctrllimited="true" ctrlrange="-5 20"/>', (5.0, np.inf)),
        ('<motor joint="a" forcerange="-5 20" gear="3"/>', (15.0, np.inf)),
        ('<motor joint="a" forcerange="0 20"/><motor joint="a" forcerange="-20 0"/>', (20.0, np.inf)),
        ('<motor joint="a" forcerange="-5 20"/><motor joint="a" forcerange="-20 5"/>', (25.0, np.inf)),
        ('<motor jointinparent="a" forcerange="-4 4"/>', (4.0, np.inf)),
    ],
    ids=["class", "control on one side", "force on one side", "two against", "two together", "in the parent"],
)
def test_motors_give_in_both_directions_what_their_actuators_can(write, actuators, efforts):
    robot = load_robot(write(TWO.format(actuators)), elastic=write(BOTH, "joints.toml"))
    assert tuple(robot.effort_limits) == efforts


def known_model(mujoco, text):
    """MuJoCo's model; the test is left out where this version does not know an element of it."""
    try:
        return mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        if "Schema violation" not in str(error):
            raise
        return pytest.skip("an element that this MuJoCo does not have")


@pytest.mark.oracle
@pytest.mark.parametrize(
    "actuator",
    [
        '<motor {} gear="30"/>',
        '<dcmotor {} motorconst="0.05" resistance="2" gear="-30"/>',
    ],
)
def test_inertia_and_friction_of_actuators_are_seen_from_the_joint_as_in_mujoco(write, actuator):
    mujoco = pytest.importorskip("mujoco")
    motor = actuator.format('joint="a" armature="2e-3" damping="1e-2" ctrlrange="-1 1"')
    text = TWO.format(motor).replace('name="a" axis', 'name="a" armature="0.3" damping="2" axis')
    text = text.replace("<worldbody>", '<option gravity="0 0 0"/><worldbody>')
    model = known_model(mujoco, text)
    arm = read_mjcf(read_xml(write(text)), ["a"])
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.0
    mujoco.mj_forward(model, data)
    data.qacc[:] = (1.0, 0.0)
    mujoco.mj_inverse(model, data)
    link = arm.links[0]
    mass, centre, moments = (np.array(x, dtype=float) for x in (link.mass, link.centre_of_mass, link.inertia))
    about_joint = moments[3] + mass * centre @ centre
    assert data.qfrc_inverse[0] == pytest.approx(about_joint + arm.motors["a"]["motor_inertia"])
    data.qvel[:] = (1.0, 0.0)
    mujoco.mj_forward(model, data)
    assert data.qfrc_passive[0] == pytest.approx(-arm.motors["a"]["friction"])


@pytest.mark.oracle
def test_a_dc_motor_is_a_motor_with_constants_before_its_gear(write):
    """Its torque against MuJoCo's, of a motor that slides, at several voltages and speeds."""
    mujoco = pytest.importorskip("mujoco")
    motor = (
        '<dcmotor joint="a" motorconst="0.05 0.06" resistance="2" gear="30" ctrlrange="-24 24" armature="2e-3" '
        'inductance="3e-3" lugre="1e5 10 0.02 0.05 4" cogging="0.01 8 0"/>'
    )
    model = known_model(mujoco, TWO.format(motor))
    arm = read_mjcf(read_xml(write(TWO.format(motor))))
    found, dry = arm.dc_motors["a"], arm.motors["a"]
    assert (found.gear_ratio, found.voltage, found.takes_voltage) == (30.0, 24.0, True)
    assert found.rotor_inertia == pytest.approx(2e-3)
    assert found.electrical["inductance"] == pytest.approx(3e-3)
    assert len(found.left_out) == 1  # its cogging
    plain = TWO.format(motor.replace('inductance="3e-3" ', "").replace('cogging="0.01 8 0"', ""))
    model, numbers = mujoco.MjModel.from_xml_string(plain), found.electrical
    for volts, speed in ((12.0, 0.5), (-3.0, 0.05), (0.0, 2.0)):
        data = mujoco.MjData(model)
        data.ctrl[:], data.qvel[:] = volts, (speed, 0.0)
        slip = (speed / dry["stribeck_velocity"]) ** 2
        sliding = dry["coulomb_friction"] + (dry["static_friction"] - dry["coulomb_friction"]) * np.exp(-slip)
        data.act[:] = sliding / 30.0 / 1e5  # how far the bristles are bent
        mujoco.mj_forward(model, data)
        induced = numbers["back_emf_constant"] * 30.0 * speed
        torque = 30.0 * numbers["torque_constant"] * (volts - induced) / numbers["resistance"] - sliding
        assert data.qfrc_actuator[0] == pytest.approx(torque, rel=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize(
    "actuator",
    [
        '<motor {} gear="100" ctrlrange="-1 1" forcerange="-2 2"/>',
        '<motor {} gear="100" ctrlrange="-1 1" forcerange="-0.5 0.5"/>',
        '<general {} gainprm="50" ctrlrange="-.5 .5" forcerange="-40 40"/>',
        '<general {} gainprm="-50" gear="-3" ctrlrange="-.5 .7" forcerange="-30 20"/>',
        '<general {} class="both" gear="87"/>',
        '<position {} kp="100" ctrlrange="-1 1" forcerange="-12 12"/>',
        '<velocity {} kv="5" ctrlrange="-9 9" forcerange="-12 12" gear="2"/>',
        '<cylinder {} timeconst="1e-9" area="30" ctrlrange="-1 1" forcerange="-60 60"/>',
        '<motor {} ctrlrange="-1 1" forcerange="-2 2"/><option><flag clampctrl="disable"/></option>',
        '<dcmotor {} motorconst="0.05" resistance="2" gear="-60" ctrlrange="-20 24" saturation="0.6"/>',
        '<dcmotor {} motorconst="0.05" resistance="2" gear="60" ctrlrange="-20 24" saturation="0.3"/>',
        '<pid {} kp="3" forcerange="-4 4"/>',
    ],
)
def test_motors_limits_are_the_largest_torques_that_mujoco_gives(write, actuator):
    """With both ranges the control is cut first, then the force, then it passes the gear."""
    mujoco = pytest.importorskip("mujoco")
    motor, _, option = actuator.format('joint="a"').partition("<option>")
    text = TWO.format(motor).replace(
        "<worldbody>", f"<option>{option}<worldbody>" if option else "<worldbody>"
    )
    both = (
        '<default class="both"><general ctrlrange="-1 1" forcerange="-150 150"/></default></default>\n<world'
    )
    text = text.replace("</default>\n<world", both)
    model = known_model(mujoco, text)
    with warnings.catch_warnings(action="ignore"):
        effort = read_mjcf(read_xml(write(text))).efforts[0]
    data, torques = mujoco.MjData(model), []
    for control in (-1e6, 1e6):
        data.ctrl[:] = data.act[:] = control
        if model.na and model.actuator_ctrllimited[0]:  # where a filter ends up
            data.act[:] = np.clip(control, *model.actuator_ctrlrange[0])
        mujoco.mj_forward(model, data)
        torques.append(abs(data.qfrc_actuator[0]))
    assert effort == pytest.approx(min(torques))


@pytest.mark.parametrize(
    "actuator",
    [
        '<motor tendon="rope" name="puller" forcerange="-4 4"/>',
        '<motor joint="b" name="pusher" forcerange="0 20"/>',
        '<general joint="b" name="puller" dyntype="integrator" ctrllimited="true" ctrlrange="-2 2"/>',
    ],
)
def test_an_actuator_that_is_not_understood_is_told_and_the_elastic_file_states_its_limit(write, actuator):
    arm = write(TWO.format(actuator))
    with pytest.warns(RobotFileWarning, match="puller|'b'"):
        robot = load_robot(arm, elastic=write(BOTH, "joints.toml"))
    assert robot.effort_limits[1] == np.inf


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name="a" axis', 'name="a" damping="1 0.5" axis', ["dampingpoly", "'a'", 0.5]),
        ("<motor ", '<motor damping="2 0.5" ', ["dampingpoly", "'a'", 0.5]),
    ],
)
def test_numbers_of_joints_and_actuators_that_are_not_read_are_refused(write, old, new, words):
    """Versions of MuJoCo add such numbers; a test of an older one has nothing to refuse."""
    text = TWO.format('<motor joint="a"/>').replace(old, new, 1)
    mujoco = pytest.importorskip("mujoco")
    known_model(mujoco, text)
    with refused_with(InvalidInput, *words):
        load_robot(write(text), elastic=write(BOTH, "joints.toml"))


SCENE = """<mujoco><compiler angle="radian"/><worldbody>
<body name="A"><joint name="a" axis="0 1 0" range="-2 2"/>
  <inertial pos="0 0 0.15" mass="1" diaginertia="0.02 0.02 0.004"/>
  <body name="G" pos="0 0.05 0.2"><joint type="ball"/>
    <inertial pos="0 0.1 0" mass="0.1" diaginertia="1e-3 1e-3 1e-3"/></body>
  <body name="B" pos="0 0 0.3">
    <joint name="b" axis="1 0 0" pos="0 0.01 0" range="-2 2" damping="0.7"/>
    <joint name="slide" type="slide" axis="0 0.6 0.8" range="0.1 0.2" stiffness="50"/>
    <joint name="twist" axis="0 0 1" pos="0.02 0 0" ref="0.3"/>
    <inertial pos="0 0.02 0.1" mass="0.5" diaginertia="0.01 0.01 0.002"/>
    <body name="F" pos="0 0 0.2"><joint name="f" axis="1 0 0" springdamper="1 1"/>
      <inertial pos="0 0.1 0" mass="0.2" diaginertia="1e-3 1e-3 1e-3"/></body>
  </body></body>
{scene}</worldbody>
<equality><connect body1="A" body2="G" anchor="0 0 0"/><joint joint1="f" joint2="slide"/></equality></mujoco>"""
THINGS = """<body name="cup" pos="1 0 0"><freejoint/><geom size="0.1"/>
  <body><joint name="lid"/><joint type="ball" axis="1 0 0"/><geom size="0.05"/></body></body>
<body name="table" pos="0 0 -1"><geom type="box" size="1 1 0.1"/></body>"""


#: A link behind a base that floats.
MOVING = """<mujoco><worldbody><body name="cup"><freejoint/><geom size="0.1"/><body name="lid"><joint name="q"/>
<geom size="0.05" pos="0.1 0 0"/></body></body></worldbody></mujoco>"""


@pytest.mark.oracle
def test_a_scene_is_left_out_and_what_is_locked_stands_still(write):
    """Springs and balls that do not move, several joints of a body, and free things do not matter; f follows slide."""
    mujoco, path = pytest.importorskip("mujoco"), write(SCENE.format(scene=THINGS))
    with pytest.warns(RobotFileWarning) as told:
        arm = read_mjcf(read_xml(path), ["a", "b"], {"twist": 0.7})
    assert unnamed(" ".join(str(each.message) for each in told), "cup", "ball", "'of body G'") == []
    assert arm.motors == {"a": {}, "b": {"friction": 0.7}}
    model = mujoco.MjModel.from_xml_string(SCENE.format(scene=""))
    dofs = [model.joint(name).dofadr[0] for name in ("a", "b")]
    data, tree = mujoco.MjData(model), Tree(arm.joints)
    bodies = bodies_of(tree, *zip(*((link.mass, link.centre_of_mass, link.inertia) for link in arm.links)))
    for q in np.random.default_rng(4).uniform(-1.0, 1.0, (5, 2)):
        for name, value in {"a": q[0], "b": q[1], "slide": 0.1, "twist": 0.7, "f": 0.1}.items():
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_forward(model, data)
        weight = inverse_dynamics(tree, bodies, q, [0.0] * 2, [0.0] * 2, (0.0, 0.0, -9.81))
        np.testing.assert_allclose(np.array(weight, dtype=float), data.qfrc_bias[dofs], atol=1e-12)
    with refused_with(InvalidInput, "'cup'", "floats", "joints ="):
        read_mjcf(read_xml(write(MOVING)))
    with refused_with(InvalidInput, "'B'", "'b', 'slide', 'twist'"):
        read_mjcf(read_xml(write(SCENE.format(scene=""))))


GRIPPER = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="a" axis="0 1 0"/>
<inertial pos="0 0 0.1" mass="1" diaginertia="0.02 0.02 0.01"/>
<body pos="0 0 0.2"><joint name="f" type="slide" axis="1 0 0" range="-0.1 0.1" ref="0.01"/>
<inertial pos="0 0 0" mass="0.1" diaginertia="1e-3 1e-3 1e-3"/></body>
<body pos="0 0 0.3"><joint name="g" type="slide" axis="1 0 0" range="-0.2 0.2" limited="true" ref="-0.02"/>
<inertial pos="0 0 0" mass="0.2" diaginertia="1e-3 1e-3 1e-3"/></body>
<body pos="0 0 0.4"><joint name="h" axis="1 0 0"/>
<inertial pos="0 0.1 0" mass="0.2" diaginertia="1e-3 1e-3 1e-3"/></body></body></worldbody>
<equality><joint joint1="g" joint2="f" polycoef="{}"/><joint joint1="h" joint2="g"/></equality></mujoco>"""


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("polynomial", "locked"),
    [("0 1 0 0 0", {"f": 0.05}), ("0.01 -2 3 -1 2", {"f": 0.05}), ("0.02", {"f": 0.05}), ("0.1 2 0 0 0", {})],
)
def test_what_follows_a_locked_joint_stands_where_mujoco_wants_it(write, polynomial, locked):
    mujoco, text = pytest.importorskip("mujoco"), GRIPPER.format(polynomial)
    arm = read_mjcf(read_xml(write(text)), ["a"], locked)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for name, value in arm.locked.items():
        data.qpos[model.joint(name).qposadr[0]] = value or 0.0
    mujoco.mj_forward(model, data)
    assert data.ne == 2
    np.testing.assert_allclose(data.efc_pos[: data.ne], 0.0, atol=1e-12)
    placed = {name: value or 0.0 for name, value in arm.locked.items()}
    placed_arm = read_mjcf(read_xml(write(text)), ["a"], placed)
    assert arm.links[0].centre_of_mass == pytest.approx(placed_arm.links[0].centre_of_mass, abs=1e-15)
    with refused_with(InvalidInput, "polycoef", "'g'"):
        read_mjcf(read_xml(write(GRIPPER.format("0 x"))), ["a"])


WEDGE = """<mujoco><asset><mesh name="wedge" vertex="0 0 0 0.2 0 0 0 0.3 0 0 0 0.4"/></asset>
<worldbody><body name="arm"><joint name="a" axis="0 1 0"/><geom type="mesh" mesh="wedge" density="700"/>
</body></worldbody></mujoco>"""


@pytest.mark.oracle
def test_a_file_with_the_masses_of_its_meshes_is_written_as_advised(write, monkeypatch, tmp_path):
    mujoco = pytest.importorskip("mujoco", minversion="3.3.1")
    with refused_with(InvalidInput, "'arm'", "'mesh'") as caught:
        read_mjcf(read_xml(write(WEDGE, "this.xml")))
    monkeypatch.chdir(tmp_path)
    exec(
        str(caught.value).partition("try: ")[2].partition(" writes it")[0].strip(),
        {"mujoco": mujoco, "pathlib": pathlib},
    )
    (link,) = read_mjcf(read_xml(tmp_path / "whole.xml")).links
    volume = 0.2 * 0.3 * 0.4 / 6.0
    assert link.mass == pytest.approx(700.0 * volume, rel=1e-5)
    assert link.centre_of_mass == pytest.approx((0.05, 0.075, 0.1), rel=1e-5)  # a quarter of each edge


@pytest.mark.parametrize("acting", ['stiffness = "3 0"', 'springdamper="0.1 1"'])
def test_a_file_without_what_pulls_its_links_is_written_as_advised(write, monkeypatch, tmp_path, acting):
    pytest.importorskip("mujoco")
    old = 'name="elbow"'
    with refused_with(InvalidInput, acting.partition("=")[0].strip()) as caught:
        rigid(write(ARM.replace(old, f"{old} {acting}", 1), "this.xml"))
    monkeypatch.chdir(tmp_path)
    exec(
        str(caught.value).partition("or: ")[2].partition(" writes a file")[0], {"pathlib": pathlib, "re": re}
    )
    assert (tmp_path / "plain.xml").read_text() == ARM


def test_a_weight_that_mujoco_takes_away_is_the_motors_and_that_is_said(write):
    """Files of arms have gravcomp for MuJoCo's position controllers; nothing of the real robot carries the weight."""
    pytest.importorskip("mujoco")
    plain = rigid(write(ARM))
    with pytest.warns(RobotFileWarning, match="gravcomp.*of 'left'"):
        arm = rigid(write(ARM.replace('name="left"', 'name="left" gravcomp="1"')))
    assert [link.mass for link in arm.links] == [link.mass for link in plain.links]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rigid(write(ARM.replace('name="column"', 'name="column" gravcomp="1"')))  # which no joint carries


def test_every_loop_is_named_with_the_joints_that_move_without_it(write):
    pytest.importorskip("mujoco")
    loops = "".join(f'<connect body1="left" body2="{other}" anchor="0 0 0"/>' for other in ("right", "tool"))
    text = ARM.replace("<actuator>", f"<equality>{loops}</equality><actuator>")
    with refused_with(
        InvalidInput, "connect of 'left, right'", "connect of 'left, tool'", "finger, other", "active='false'"
    ) as caught:
        rigid(write(text))
    chosen = re.findall(r"joints = \[(.*?)\]", str(caught.value))[0].replace('"', "").split(", ")
    assert [joint.name for joint in read_mjcf(read_xml(write(text)), chosen).joints] == ["shoulder", "elbow"]


@pytest.mark.parametrize("quaternion", ["-1 0 0 0", "-1 1e-200 0 0", "-2 0 0 0"])
def test_a_body_that_is_not_turned_may_say_so_by_minus_one(write, quaternion):
    """MuJoCo writes such quaternions where turns cancel each other."""
    pytest.importorskip("mujoco")
    text, plain = GRIPPER.format("0 1"), '<body pos="0 0 0.3">'
    assert plain in text
    said, unsaid = (
        read_mjcf(read_xml(write(each)), ["a"]).links[0]
        for each in (text.replace(plain, f'<body pos="0 0 0.3" quat="{quaternion}">'), text)
    )
    assert (said.mass, said.centre_of_mass, said.inertia) == (
        unsaid.mass,
        unsaid.centre_of_mass,
        unsaid.inertia,
    )
