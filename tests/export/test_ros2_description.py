"""What starts the package for ROS 2: launch file, URDF with interfaces of ros2_control, parameters for spawners."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.export.test_rest import elastic_controller

import flexhinf as fh
from flexhinf.cli.commands import without_ros
from flexhinf.export.controller_c import code_of
from flexhinf.export.rendering import FILTERS, render_c
from flexhinf.export.ros2 import ros2_values
from flexhinf.export.ros2_description import roll_pitch_yaw

yaml = pytest.importorskip("yaml")

#: Names that mean something in XML, in xacro, in YAML, and between joint and interface.
WILD = ("left/j1", """a&b<"'>${1+1}$$(find#:""")
PACKAGE = "arm_controller"
FILES = {
    "parameters": "controller.yaml",
    "urdf": "robot.xml",
    "control": "ros2_control.xml",
    "launch": "launch.jinja",
    "mujoco": "mujoco.jinja",
    "package": "package.xml",
}


def texts_of(controller: fh.Controller, robot: fh.Robot | None, home: np.ndarray) -> dict[str, str]:
    code = code_of(controller, "arm", "double", robot)
    values = {**code.values, "follows": robot is not None, **ros2_values(code, home)}
    return {kind: render_c(f"ros2/{name}", "arm", code.real, **values) for kind, name in FILES.items()}


def wild_robot(folder: Path) -> fh.Robot:
    text = (Path(fh.__file__).parent / "robot/catalogue/planar-two-link.toml").read_text()
    for before, after in zip(("shoulder", "elbow"), WILD, strict=True):
        text = text.replace(json.dumps(before), json.dumps(after))
    (folder / "arm.toml").write_text(text)
    return fh.load_robot(folder / "arm.toml")


@pytest.fixture(scope="module")
def wild(tmp_path_factory: pytest.TempPathFactory) -> tuple[fh.Robot, dict[str, str]]:
    robot = wild_robot(tmp_path_factory.mktemp("wild"))
    return robot, texts_of(elastic_controller(robot), robot, np.array([0.1, -0.2]))


def by_xacro(text: str) -> str:
    """What xacro makes of a text without a macro: a $ that follows others before a bracket is a letter."""
    return text.replace("$$$(", "$$(").replace("$${", "${")


def interfaces(control: ElementTree.Element, kind: str) -> list[str]:
    return [
        by_xacro(f"{part.get('name')}/{one.get('name')}")
        for system in control.iter("ros2_control")
        for part in system
        for one in part.iter(f"{kind}_interface")
    ]


def check_interfaces(texts: Mapping[str, str]) -> None:
    stated = yaml.safe_load(texts["parameters"])[PACKAGE]["ros__parameters"]
    control = ElementTree.fromstring(texts["control"])
    for kind, group in (("state", "measurements"), ("command", "inputs")):
        expected = [signal["interface"] for signal in stated[group].values()]
        assert sorted(interfaces(control, kind)) == sorted(expected)
    ends = {
        signal["interface"]: {"min": signal["lower"], "max": signal["upper"]}
        for signal in stated["inputs"].values()
    }
    for part in control.iter():
        for one in part.findall("command_interface"):
            found = {row.get("name"): float(str(row.text)) for row in one}
            assert found == ends[by_xacro(f"{part.get('name')}/{one.get('name')}")]
    # Jazzy refuses a joint of <ros2_control> that the URDF has not
    joints = {joint.get("name") for joint in ElementTree.fromstring(texts["urdf"]).iter("joint")}
    assert {joint.get("name") for joint in control.iter("joint")} <= joints


def test_the_description_has_the_interfaces_of_the_parameters(wild: tuple[fh.Robot, dict[str, str]]) -> None:
    check_interfaces(wild[1])
    names = [
        by_xacro(str(joint.get("name"))) for joint in ElementTree.fromstring(wild[1]["urdf"]).iter("joint")
    ]
    assert names == list(WILD)
    parts = ElementTree.fromstring(wild[1]["urdf"])
    ends = [[str(one.find(end).get("link")) for end in ("parent", "child")] for one in parts.iter("joint")]  # type: ignore[union-attr]
    assert [parent for parent, _ in ends] == ["base_link", ends[0][1]]


def test_a_controller_of_no_robot_has_one_joint() -> None:
    law = fh.linear_law(fh.paper_arm().problem(), gamma=np.inf)
    texts = texts_of(fh.Controller(law, None, 1e-3, 48.0), None, np.zeros(1))
    check_interfaces(texts)
    assert 'name="motor_velocity"' in texts["control"]
    (joint,) = ElementTree.fromstring(texts["urdf"]).iter("joint")
    assert (joint.get("name"), joint.get("type")) == ("joint", "continuous")


class Sensors(fh.Law):
    """A law of what belongs to no joint."""

    state_names, input_names = ("room_temperature",), ("valve",)
    operating_point, operating_input = np.zeros(1), np.zeros(1)

    @property
    def law_data(self) -> np.ndarray:
        return np.ones(1)

    def evaluate_law(self, x: Any, data: Any) -> Any:
        return np.array([-(data @ x)])


def test_what_belongs_to_no_joint_is_no_joint_of_the_description() -> None:
    texts = texts_of(fh.Controller(Sensors(), None, 1e-3, 2.0), None, np.zeros(1))
    check_interfaces(texts)
    control = ElementTree.fromstring(texts["control"])
    assert [part.get("name") for part in control.iter("gpio")] == ["valve", "room_temperature"]
    assert list(control.iter("joint")) == []


def test_the_mock_begins_at_rest_where_the_command_is(wild: tuple[fh.Robot, dict[str, str]]) -> None:
    control = ElementTree.fromstring(wild[1]["control"])
    found = {
        f"{k}/{one.get('name')}": float(one.findtext("param") or "nan")
        for k, part in enumerate(control.iter("joint"))
        for one in part.iter("state_interface")
    }
    assert found == {"0/position": 0.1, "1/position": -0.2, "0/motor_position": 0.1, "1/motor_position": -0.2}


@pytest.mark.oracle
def test_pinocchio_finds_the_links_where_the_robot_has_them(wild: tuple[fh.Robot, dict[str, str]]) -> None:
    """The tree of the URDF, whose links have neither mass nor shape."""
    pinocchio = pytest.importorskip("pinocchio")
    robot, texts = wild
    model = pinocchio.buildModelFromXML(texts["urdf"])
    assert [by_xacro(name) for name in list(model.names)[1:]] == list(WILD)
    q = np.array([0.3, -0.7])
    data = model.createData()
    pinocchio.forwardKinematics(model, data, q)
    tree = robot.links.tree
    place = np.eye(4)
    for k, (joint, angle) in enumerate(zip(tree.joints, q, strict=True)):
        step, turn = np.eye(4), np.eye(4)
        step[:3, :3], step[:3, 3] = joint.placement.rotation, joint.placement.translation
        turn[:3, :3] = pinocchio.exp3(angle * np.asarray(joint.axis, dtype=float))
        place = place @ step @ turn
        np.testing.assert_allclose(data.oMi[k + 1].homogeneous, place, atol=1e-12)
    ranges = [joint.limits for joint in tree.joints if joint.limits is not None]
    assert len(ranges) == len(tree)
    np.testing.assert_allclose([model.lowerPositionLimit, model.upperPositionLimit], np.transpose(ranges))


@pytest.mark.oracle
def test_angles_of_a_urdf_are_those_of_scipy() -> None:
    """Also where roll and yaw turn about one axis."""
    rotations = Rotation.from_quat(np.random.default_rng(1).normal(size=(20, 4))).as_matrix()
    upright = [Rotation.from_euler("xyz", [0.3, sign * np.pi / 2, -0.8]).as_matrix() for sign in (1, -1)]
    for matrix in (*rotations, *upright):
        angles = roll_pitch_yaw(matrix.tolist())
        np.testing.assert_allclose(Rotation.from_euler("xyz", angles).as_matrix(), matrix, atol=1e-9)


def test_xacro_makes_one_description_with_the_plugin_of_the_hardware(
    wild: tuple[fh.Robot, dict[str, str]], tmp_path: Path
) -> None:
    xacro = pytest.importorskip("xacro", reason="not in the locks: xacro of ROS 2")
    (tmp_path / f"{PACKAGE}.ros2_control.xacro").write_text(wild[1]["control"])
    path = tmp_path / f"{PACKAGE}.urdf.xacro"
    path.write_text(wild[1]["urdf"])
    made = xacro.process_file(str(path), mappings={"hardware": "my/Drives"}).toxml()
    whole = ElementTree.fromstring(made)
    assert [joint.get("name") for joint in whole.findall("joint")] == list(WILD)
    assert [joint.get("name") for joint in whole.findall("ros2_control/joint")] == list(WILD)
    assert whole.findtext("ros2_control/hardware/plugin") == "my/Drives"


def test_only_a_bracket_behind_it_makes_an_expression_of_a_dollar() -> None:
    written = {text: FILTERS["xacro"](text) for text in ("$", "a$b", "${x}", "$$(x)", "$ {")}
    assert written == {"$": "$", "a$b": "a$b", "${x}": "$${x}", "$$(x)": "$$$(x)", "$ {": "$ {"}


def test_spawners_from_humble_to_rolling_find_type_and_parameters(
    wild: tuple[fh.Robot, dict[str, str]],
) -> None:
    """Humble's manager reads `type` among its own parameters, where it may come from the manager's file; later spawners
    read it under the controller's name in the file of --param-file, and since Jazzy its parameters come from there
    alone. All read a controller by its bare name only where they are in no namespace."""
    stated = yaml.safe_load(wild[1]["parameters"])
    manager = stated["controller_manager"]["ros__parameters"]
    kinds = {
        PACKAGE: f"{PACKAGE}/Controller",
        "joint_state_broadcaster": "joint_state_broadcaster/JointStateBroadcaster",
    }
    assert manager == {"update_rate": 1000, **{name: {"type": kind} for name, kind in kinds.items()}}
    assert {name: stated[name]["ros__parameters"]["type"] for name in kinds} == kinds
    assert stated.keys() == {"controller_manager", *kinds}
    assert all(set(group) == {"ros__parameters"} for group in stated.values())


class Recorded:
    """Any action or substitution of a launch file, with what it got."""

    def __init__(self, *words: Any, **named: Any) -> None:
        self.words, self.named = words, named

    @property
    def text(self) -> str:
        """Texts within, one after the other."""
        parts = [word if isinstance(word, (list, tuple)) else [word] for word in self.words]
        return "".join(
            part.text if isinstance(part, Recorded) else str(part) for row in parts for part in row
        )


#: What the launch file has of ROS 2; the names are the same from Humble to Rolling.
LAUNCH = {
    "launch": ("LaunchDescription",),
    "launch.actions": ("DeclareLaunchArgument", "EmitEvent", "ExecuteProcess"),
    "launch.events": ("Shutdown",),
    "launch.conditions": ("IfCondition", "UnlessCondition"),
    "launch.substitutions": ("Command", "LaunchConfiguration", "PathJoinSubstitution"),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
    "launch_ros.substitutions": ("FindPackageShare",),
}


@pytest.fixture
def launched(wild: tuple[fh.Robot, dict[str, str]], monkeypatch: pytest.MonkeyPatch) -> list[Recorded]:
    return launched_by(wild[1]["launch"], monkeypatch)


def launched_by(text: str, monkeypatch: pytest.MonkeyPatch) -> list[Recorded]:
    """Actions of a launch file, by kind of stub."""
    for name, kinds in LAUNCH.items():
        module = ModuleType(name)
        for kind in kinds:
            setattr(module, kind, type(kind, (Recorded,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    scope: dict[str, Any] = {}
    exec(compile(text, "arm_controller.launch.py", "exec"), scope)
    make: Callable[[], Recorded] = scope["generate_launch_description"]
    return list(make().words[0])


def test_mujoco_is_started_as_a_node_with_the_names_of_the_plugin(
    wild: tuple[fh.Robot, dict[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command is one that the command line takes; ROS 2 alone is missing here."""
    actions = launched_by(wild[1]["mujoco"], monkeypatch)
    (process,) = (action for action in actions if kind_of(action) == "ExecuteProcess")
    stated = {"design": "a folder", "arguments": "--view"}
    command = "".join(
        stated[word.words[0]] if isinstance(word, Recorded) else word for word in process.named["cmd"]
    )
    words = shlex.split(command)
    assert words == [
        "flexhinf", "run", "a folder", "--view", "--ros", "--ros-args", "-r", f"__node:={PACKAGE}"
    ]  # fmt: skip
    assert without_ros(words) == words[:5]
    declared = {action.words[0] for action in actions if kind_of(action) == "DeclareLaunchArgument"}
    assert declared == stated.keys()


def kind_of(action: Recorded) -> str:
    return type(action).__name__


def test_the_launch_file_declares_every_argument_that_it_uses(
    launched: list[Recorded], wild: tuple[fh.Robot, dict[str, str]]
) -> None:
    arguments = [action for action in launched if kind_of(action) == "DeclareLaunchArgument"]
    defaults = {action.words[0]: action.named["default_value"] for action in arguments}
    used: set[str] = set()

    def walk(value: Any) -> None:
        if isinstance(value, Recorded):
            used.update([value.words[0]] if kind_of(value) == "LaunchConfiguration" else [])
            walk([value.words, value.named])
        elif isinstance(value, Mapping):
            walk(list(value.values()))
        elif isinstance(value, (list, tuple)):
            for one in value:
                walk(one)

    walk([action for action in launched if kind_of(action) == "Node"])
    assert used == set(defaults)
    texts = {name: value.text if isinstance(value, Recorded) else value for name, value in defaults.items()}
    assert texts == {
        "description": f"{PACKAGE}urdf{PACKAGE}.urdf.xacro",
        "hardware": "mock_components/GenericSystem",
        "parameters": f"{PACKAGE}config{PACKAGE}.yaml",
        "manager": "true",
        "controller_manager": "controller_manager",
        "joint_states": "true",
        "active": "true",
    }
    assert all(action.named["description"] for action in arguments)
    (argument,) = (one for one in ElementTree.fromstring(wild[1]["control"]) if one.tag.endswith("arg"))
    assert (argument.get("name"), argument.get("default")) == ("hardware", texts["hardware"])


def test_the_launch_file_starts_a_manager_with_the_description_and_two_controllers(
    launched: list[Recorded], wild: tuple[fh.Robot, dict[str, str]]
) -> None:
    nodes = [action for action in launched if kind_of(action) == "Node"]
    called = [
        (
            node.named["package"],
            node.named["executable"],
            kind_of(node.named["condition"]),
            node.named["condition"].text,
        )
        for node in nodes
    ]
    assert called == [
        ("robot_state_publisher", "robot_state_publisher", "IfCondition", "manager"),
        ("controller_manager", "ros2_control_node", "IfCondition", "manager"),
        ("controller_manager", "spawner", "IfCondition", "joint_states"),
        ("controller_manager", "spawner", "IfCondition", "active"),
        ("controller_manager", "spawner", "UnlessCondition", "active"),
    ]
    published, manager, *spawners = nodes
    (described,) = published.named["parameters"]
    assert described["robot_description"].text == "xacro 'description' hardware:='hardware'"
    assert manager.named["parameters"][0].text == "parameters"
    assert manager.named["remappings"] == [("~/robot_description", "/robot_description")]
    told = [
        [word.text if isinstance(word, Recorded) else word for word in node.named["arguments"]]
        for node in spawners
    ]
    common = ["--controller-manager", "controller_manager", "--controller-manager-timeout", "60",
              "--param-file", "parameters"]  # fmt: skip
    assert told == [
        ["joint_state_broadcaster", *common],
        [PACKAGE, *common],
        [PACKAGE, *common, "--inactive"],
    ]
    needed = {row.text for row in ElementTree.fromstring(wild[1]["package"]).iter("exec_depend")}
    assert needed == {
        *(node.named["package"] for node in nodes),
        *("launch", "launch_ros", "xacro"),
        "joint_state_broadcaster",
    }
