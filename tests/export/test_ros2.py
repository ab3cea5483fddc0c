"""The package for ROS 2: compiled against stubs of the real signatures, and run as a controller manager does, with
MuJoCo as the robot."""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from tests.export.test_rest import controller_of, robot_of
from tests.loop.controller.test_signs import made as protected

import flexhinf as fh
from flexhinf.robot import MuJoCoPlant

yaml = pytest.importorskip("yaml")

# Packages are built with flags that stand here; unoptimised are loops in Python.
pytestmark = [
    pytest.mark.usefixtures("unoptimised"),
    pytest.mark.ci("builds a package, which its tests share"),
]

HERE = Path(__file__).parent / "ros2"
PERIOD, FOLLOWING = 1e-3, 0.1  # s; rad, from where on a joint does not follow
LOOKS, ARM = 51, fh.paper_arm()  # samples that it looks at before the first of its own
VERSIONS = {"HUMBLE": (), "JAZZY": ("-DJAZZY",), "ROLLING": ("-DJAZZY", "-DROLLING")}
STRICT = ("-std=c++17", "-O0", "-fPIC", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{HERE / 'stubs'}")

no_estimator = cache(lambda: fh.Controller(fh.linear_law(ARM.problem(), gamma=math.inf), None, PERIOD, 48.0))


@cache
def arm_controller(latency: int = 0, measured: str = "link_position", **options: Any) -> fh.Controller:
    ekf = fh.ExtendedKalmanFilter(ARM.plant(measured), PERIOD, 1e-7, 1e-8, [0.0] * 4, 1e-4)
    law = fh.linear_law(ARM.problem(), gamma=math.inf)
    return fh.Controller(law, ekf, PERIOD, 48.0, latency=latency, **options)


@cache
def workspace_controller() -> fh.Controller:
    watch = fh.Supervision(([-1.0, -1.0], [0.3, 1.0]), reactions={"workspace": "brake"}, following=FOLLOWING)
    return controller_of("planar-two-link", watch=watch)


@dataclass
class Manager:
    """One controller in a shared library, with what a controller manager knows of it."""

    library: ctypes.CDLL
    package: Path
    address: int = 0

    def __post_init__(self) -> None:
        for name, kind in (("create", ctypes.c_void_p), ("values", ctypes.POINTER(ctypes.c_double)),
                           ("interface_name", ctypes.c_char_p), ("reference_name", ctypes.c_char_p),
                           ("exported_state", ctypes.c_double), ("plugin_class", ctypes.c_char_p),
                           ("plugin_base", ctypes.c_char_p), ("published", ctypes.c_double)):  # fmt: skip
            getattr(self.library, name).restype = kind
        self.address = self.library.create()

    def __call__(self, name: str, *arguments: Any) -> Any:
        return getattr(self.library, name)(ctypes.c_void_p(self.address), *arguments)

    def configure(self, rate: int = 1000, **other: Any) -> int:
        """Parameters of the file, but for `other` ones, whose dots are two underscores; then the first two steps."""
        whole = yaml.safe_load((self.package / "config/arm_controller.yaml").read_text())
        assert whole["controller_manager"]["ros__parameters"]["update_rate"] == 1000
        stated = dict(flat(whole["arm_controller"]["ros__parameters"]))
        changed = {name.replace("__", "."): value for name, value in other.items()}
        assert changed.keys() <= stated.keys()
        for name, value in (stated | changed).items():
            if isinstance(value, list):
                self(
                    "set_texts",
                    name.encode(),
                    (ctypes.c_char_p * len(value))(*map(str.encode, value)),
                    len(value),
                )
                continue
            kinds = {str: ("set_text", lambda text: text.encode()), bool: ("set_truth", ctypes.c_bool),
                     int: ("set_whole", ctypes.c_int64), float: ("set_number", ctypes.c_double)}  # fmt: skip
            write, made = kinds[type(value)]
            self(write, name.encode(), made(value))
        return self("init") or self("configure", ctypes.c_uint(rate))

    def names(self, commands: bool) -> list[str]:
        found: list[str] = []
        while (name := self("interface_name", int(commands), len(found))) is not None:
            found.append(name.decode())
        return found

    def measure(self, y: Sequence[float]) -> None:
        place = self("values", 0)
        for k, value in enumerate(y):
            place[k] = value

    def input(self) -> np.ndarray:
        return np.array([self("values", 1)[k] for k in range(len(self.names(True)))])

    def activate(self, y: Sequence[float], left_out: tuple[int, int] = (0, 0), looks: int = LOOKS) -> int:
        """Then updates in which it looks whether the robot rests."""
        self.measure(y)
        return self("activate", *left_out) or max((self.update(y) for _ in range(looks)), default=0)

    def send(self, rows: Any) -> None:
        numbers = np.ascontiguousarray(np.ravel(rows), dtype=float)
        self("send", numbers.ctypes.data_as(ctypes.c_void_p), len(numbers))

    def update(self, y: Sequence[float], period: float = PERIOD) -> int:
        self.measure(y)
        code = self("update", ctypes.c_int64(round(1e9 * period)))
        self("spin")
        return code

    def published(self, group: str, name: str) -> float:
        return self("published", group.encode(), name.encode())


def flat(parameters: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in parameters.items():
        if isinstance(value, dict):
            yield from flat(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value


@cache
def manager_part(version: str) -> bytes:
    """The object of the manager's part, which knows no controller."""
    with TemporaryDirectory() as folder:
        words = ["g++", *STRICT, *VERSIONS[version], "-c", HERE / "manager.cpp", "-o", f"{folder}/manager.o"]
        subprocess.run(words, check=True)
        return (Path(folder) / "manager.o").read_bytes()


def built(folder: Path, version: str = "HUMBLE") -> tuple[ctypes.CDLL, Path]:
    """The package of an exported controller in a shared library, with the manager's part, and its folder."""
    if shutil.which("g++") is None or shutil.which("gcc") is None:
        pytest.skip("missing: g++")
    package, objects = folder / "ros2", [folder.parent / "manager.o"]
    objects[0].write_bytes(manager_part(version))
    own = (f"-I{package / 'include'}", f"-I{package / 'src'}")
    for source in (package / "src").glob("*.c*"):
        objects.append(folder.parent / f"{source.stem}.o")
        c = ("gcc", "-std=c99", "-O0", "-fPIC", "-Wall", "-Wextra", "-Werror")
        words = c if source.suffix == ".c" else ("g++", *STRICT, *VERSIONS[version], *own)
        subprocess.run([*words, "-c", source, "-o", objects[-1]], check=True)
    subprocess.run(["g++", "-shared", *objects, "-lm", "-o", folder.parent / "controller.so"], check=True)
    return ctypes.CDLL(str(folder.parent / "controller.so")), package


@pytest.fixture(scope="module")
def managed(sources_of: Callable[..., Path]) -> Callable[..., Callable[[], Manager]]:
    """Exports and builds a controller's package; makes new managers of it."""

    @cache
    def build(controller: fh.Controller, version: str = "HUMBLE") -> Callable[[], Manager]:
        library, package = built(sources_of(controller), version)
        return lambda: Manager(library, package)

    return build


@pytest.fixture(scope="module")
def arm(managed: Callable[..., Callable[[], Manager]]) -> Callable[[], Manager]:
    return managed(arm_controller(0, start="bumpless"))


def driven(manager: Manager, plant: Any, x: Any, rows: Any, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """States and inputs of a loop of the controller and a plant that begins at x; the rows are sent at the start."""
    plant.reset(x)
    assert manager.activate(plant.output()) == 0
    manager.send(rows)
    states, inputs = [], []
    for _ in range(samples):
        states.append(plant.state())
        assert manager.update(plant.output()) == 0
        inputs.append(manager.input())
        plant.step(inputs[-1], [], PERIOD)
    return np.array(states), np.array(inputs)


def expected_loop(
    controller: fh.Controller, plant: Any, x: Any, u: Any, rows: Any, samples: int
) -> tuple[np.ndarray, np.ndarray]:
    """The same in Python, sample by sample."""
    one = controller.fresh()
    one.reset(x, u)
    plant.reset(x)
    states, inputs, before = [], [], np.asarray(one.input_before(u), dtype=float)
    for k in range(samples):
        states.append(plant.state())
        after = one.step(plant.output(), rows[min(k, len(rows) - 1)])
        inputs.append(before if controller.mode.latency else after)
        plant.step(inputs[-1], [], PERIOD)
        before = after
    return np.array(states), np.array(inputs)


def assert_near(found: np.ndarray, expected: np.ndarray, share: float = 1e-9) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=share * np.abs(expected).max())


@pytest.mark.ci("exports a controller for each row")
@pytest.mark.parametrize(
    ("version", "compiler", "real", "kind"),
    [  # every pair of them once; with g++, double and an estimator they are `built` by the same words
        ("HUMBLE", "g++", "double", "no estimator"), ("JAZZY", "clang++", "float", "no estimator"),
        ("HUMBLE", "clang++", "float", "protected"),
        ("HUMBLE", "clang++", "double", "workspace"), ("JAZZY", "g++", "float", "workspace"),
        ("ROLLING", "clang++", "double", "workspace"), ("ROLLING", "g++", "double", "no estimator"),
    ],
)  # fmt: skip
def test_no_compiler_warns(
    version: str, compiler: str, real: str, kind: str, sources_of: Callable[..., Path], tmp_path: Path
) -> None:
    """clang says all of them when it has read the source; gcc some when it writes code."""
    if shutil.which(compiler) is None:
        pytest.skip(f"missing: {compiler}")
    kinds = {"protected": protected, "workspace": workspace_controller, "no estimator": no_estimator}
    robot = robot_of("planar-two-link") if kind == "workspace" else None
    package = sources_of(kinds[kind](), real, robot) / "ros2"
    own = (f"-I{package / 'include'}", f"-I{package / 'src'}", *VERSIONS[version])
    end = ("-fsyntax-only",) if compiler == "clang++" else ("-o", tmp_path / "out.o")
    for source in (package / "src").glob("*.cpp"):
        subprocess.run([compiler, *STRICT, *own, "-c", source, *end], check=True)


def test_the_package_is_found_under_the_names_of_its_plugin(arm: Callable[[], Manager]) -> None:
    one = arm()
    plugin = ElementTree.parse(one.package / "arm_controller.xml").getroot()
    described = plugin.find("class")
    assert described is not None
    assert described.get("type") == one.library.plugin_class().decode()
    assert described.get("base_class_type") == one.library.plugin_base().decode()
    parameters = yaml.safe_load((one.package / "config/arm_controller.yaml").read_text())
    manager = parameters["controller_manager"]["ros__parameters"]
    assert manager["arm_controller"]["type"] == described.get("name")
    read_by_spawner = parameters["arm_controller"]["ros__parameters"]
    assert read_by_spawner["type"] == described.get("name")
    about = ElementTree.parse(one.package / "package.xml").getroot()
    assert about.findtext("name") == "arm_controller" == plugin.get("path")
    listed = (one.package / "CMakeLists.txt").read_text()
    needed = {depend.text for depend in about.iter("depend")}
    assert needed <= set(listed.split("set(DEPENDENCIES ")[1].split(")")[0].split())
    sources = {f"src/{file.name}" for file in (one.package / "src").iterdir() if file.suffix != ".h"}
    assert sources <= set(listed.split("SHARED\n")[1].split(")")[0].split())


@pytest.mark.ci("builds two packages, and moves them with MuJoCo")
@pytest.mark.oracle
@pytest.mark.parametrize(("latency", "version"), [(0, "HUMBLE"), (1, "JAZZY")])
def test_it_drives_mujoco_as_python_does_and_begins_again_elsewhere(
    latency: int, version: str, managed: Callable[..., Callable[[], Manager]]
) -> None:
    """Also after it was off, with the robot at rest at another pose: no input jumps."""
    pytest.importorskip("mujoco")
    robot = fh.load_robot("paper")
    controller = arm_controller(latency, start="bumpless")
    manager, plant = managed(controller, version)(), MuJoCoPlant(robot)
    assert manager.configure() == 0
    assert manager.names(False) == ["joint/position"]
    assert manager.names(True) == ["joint/voltage"]
    run = fh.Loop(MuJoCoPlant(robot), controller).run(fh.Step(0.4), noise=0.0, duration=0.3 - PERIOD)
    states, inputs = driven(manager, plant, np.zeros(4), [0.4], 300)
    assert_near(states, run.signals["state"])
    if latency == 0:
        assert_near(inputs, run.signals["input"])
    assert manager.published("health", "code") == 0
    assert manager.published("health", "path_rate") == 1
    assert manager.published("estimate", "link_position") == pytest.approx(states[-1][0], abs=1e-2)
    assert manager("deactivate") == 0
    assert np.array_equal(manager.input(), [0.0])
    x, u = robot.operating_point(-0.5)
    states, inputs = driven(manager, plant, x, [-0.3], 300)
    found = expected_loop(controller, MuJoCoPlant(robot), x, u, [[-0.3]], 300)
    assert inputs[0] == pytest.approx(u, rel=0.05)
    assert_near(states, found[0])
    assert_near(inputs, found[1], 1e-7)


@pytest.mark.ci("6,000 samples with MuJoCo")
@pytest.mark.oracle
def test_a_session_is_cleaned_up_and_configured_for_another_robot(arm: Callable[[], Manager]) -> None:
    """As a launch file has it: the file's parameters, a path, an end; then interfaces of other names, an encoder before
    a gear of 50, and a drive that counts in mV. MuJoCo is the robot, which is moved in between."""
    pytest.importorskip("mujoco")
    robot, one = fh.load_robot("paper"), arm()
    other = {
        "measurements__link_position__interface": "elbow/encoder",
        "measurements__link_position__factor": 0.02,
        "inputs__motor_voltage__interface": "elbow/millivolts",
        "inputs__motor_voltage__factor": 1000.0,
        "publish_every": 1,
    }
    for goal, pose, gear, scale, named in (
        (0.4, 0.0, 1.0, 1.0, {}),
        (-0.3, -0.5, 50.0, 1e-3, other),
    ):
        assert one.configure(**named) == 0
        assert [one.names(False), one.names(True)] == (
            [["elbow/encoder"], ["elbow/millivolts"]] if named else [["joint/position"], ["joint/voltage"]]
        )
        plant, codes = MuJoCoPlant(robot), set()
        plant.reset(robot.operating_point(pose)[0])
        assert one.activate(gear * plant.output()) == 0
        one.send(np.linspace(pose, goal, 500))
        for _ in range(3000):
            assert one.update(gear * plant.output()) == 0
            plant.step(scale * one.input(), [], PERIOD)
            codes.add(one.published("health", "code"))
        assert plant.state()[0] == pytest.approx(goal, abs=5e-3)
        assert scale * one.input() == pytest.approx(robot.operating_point(goal)[1], rel=0.05)
        assert codes - {7.0} == {0.0}  # it has looked whether the robot rests
        assert one.published("health", "missed_writes") == one.published("health", "status") == 0
        assert one("deactivate") == 0
        assert one("cleanup") == 0


@pytest.mark.oracle
def test_without_a_command_it_holds_the_pose_at_which_it_was_activated(arm: Callable[[], Manager]) -> None:
    pytest.importorskip("mujoco")
    robot = fh.load_robot("paper")
    one, plant = arm(), MuJoCoPlant(robot)
    assert one.configure() == 0
    x, u = robot.operating_point(0.7)
    plant.reset(x)
    assert one.activate(plant.output()) == 0
    for _ in range(200):
        assert one.update(plant.output()) == 0
        plant.step(one.input(), [], PERIOD)
    assert plant.state() == pytest.approx(x, abs=1e-3)
    assert one.input() == pytest.approx(u, rel=1e-2)
    assert one("deactivate") == 0
    assert one.input() == 0.0


@pytest.mark.ci("builds one more package")
def test_the_link_is_found_from_the_motor_alone(managed: Callable[..., Callable[[], Manager]]) -> None:
    """By the spring that the weight twists; the factor is that of a gear."""
    one = managed(arm_controller(measured="motor_position", start="bumpless"))()
    assert one.configure(measurements__motor_position__factor=0.01) == 0
    x, u = fh.load_robot("paper").operating_point(0.7)
    assert x[2] - x[0] > 0.01
    assert one.activate([100.0 * x[2]]) == 0
    assert one.update([100.0 * x[2]]) == 0
    assert one.input() == pytest.approx(u, rel=1e-2)


@pytest.mark.parametrize(
    ("rate", "stated"),
    [
        (500, {}),
        (1000, {"period": 2e-3}),
        (1000, {"publish_every": 0}),
        (1000, {"measurements__link_position__interface": "position"}),
        (1000, {"measurements__link_position__factor": 0.0}),
        (1000, {"measurements__link_position__factor": math.nan}),
        (1000, {"inputs__motor_voltage__lower": 50.0}),
        (1000, {"inputs__motor_voltage__upper": math.nan}),
        (1000, {"inputs__motor_voltage__factor": 7}),  # a whole number is another type
    ],
)
def test_what_does_not_fit_is_refused_at_the_configuration(
    rate: int, stated: dict[str, Any], arm: Callable[[], Manager], capfd: pytest.CaptureFixture[str]
) -> None:
    assert arm().configure(rate, **stated) == 1
    assert "ERROR" in capfd.readouterr().err


def test_an_interface_that_is_missing_or_not_measured_is_refused(
    arm: Callable[[], Manager], capfd: pytest.CaptureFixture[str]
) -> None:
    assert (one := arm()).configure() == 0
    for left_out, name in (((1, 0), "joint/position"), ((0, 1), "joint/voltage")):
        assert one.activate([0.0], left_out) == 1
        assert name in capfd.readouterr().err
    assert [one.activate([q]) for q in (math.nan, 0.0)] == [1, 0]


@pytest.mark.parametrize(("period", "calls"), [(2e-3, 3), (1.12e-3, 56)])
def test_a_manager_of_another_rate_is_noticed(
    period: float, calls: int, arm: Callable[[], Manager], capfd: pytest.CaptureFixture[str]
) -> None:
    """Where the controller states no rate, it is that of the manager."""
    one = arm()
    assert one.configure(rate=0) == 0
    assert one.activate([0.0]) == 0
    one.send([0.1])
    assert [one.update([0.0], period) for _ in range(calls)] == [0] * calls
    assert one.input() != 0.0
    assert [one.update([0.0], period) for _ in range(3)] == [1] * 3
    assert one.input() == 0.0
    assert one.published("health", "stopped") == 1
    assert one("deactivate") == 0
    assert capfd.readouterr().err.count("wrong_period") == 1
    assert one.published("health", "stop.wrong_period") == 1
    assert one.activate([0.0]) == 0
    assert [one.update([0.0]) for _ in range(600)] == [0] * 600


def test_limits_and_factors_are_those_of_the_parameters(arm: Callable[[], Manager]) -> None:
    one = arm()
    limits = {"inputs__motor_voltage__lower": -2.0, "inputs__motor_voltage__upper": 3.0}
    assert one.configure(**limits, inputs__motor_voltage__factor=10.0) == 0
    assert one.activate([0.0]) == 0
    for goal, limit in ((5.0, 30.0), (-5.0, -20.0)):
        one.send([goal])
        for _ in range(30):
            one.update([0.0])
        assert one.input() == limit


def test_a_command_that_is_none_changes_nothing_and_an_old_one_is_over(
    arm: Callable[[], Manager], capfd: pytest.CaptureFixture[str]
) -> None:
    one, other = arm(), arm()
    for manager in (one, other):
        assert manager.configure() == 0
    one.send([0.3])  # before the activation
    for manager in (one, other):
        assert manager.activate([0.1]) == 0
    for bad in ([], [math.nan], [0.2, math.inf]):
        one.send(bad)
    assert capfd.readouterr().err.count("is ignored") == 3
    for _ in range(50):
        assert one.update([0.1]) == other.update([0.1]) == 0
        assert np.array_equal(one.input(), other.input())
    one.send([0.3])
    for _ in range(5):
        one.update([0.1])
        other.update([0.1])
    assert not np.array_equal(one.input(), other.input())


def test_health_is_published(arm: Callable[[], Manager]) -> None:
    one = arm()
    assert (one.configure(publish_every=1), one.activate([0.0])) == (0, 0)
    for _ in range(5):
        one.update([0.0])
    read = [("health", "code"), ("measured", "link_position"), ("input", "motor_voltage")]
    assert [one.published(*each) for each in read] == [0, 0, one.input()]
    assert one.update([0.0], 3 * PERIOD) == 0
    said = [one.published("health", name) for name in ("late_samples", "doubtful_estimate")]
    assert said == [1, 0]


def test_without_measurements_it_ends_until_it_is_activated_again(arm: Callable[[], Manager]) -> None:
    one = arm()
    assert one.configure(publish_every=1000) == 0
    assert one.activate([0.0]) == 0
    assert one.update([0.0]) == 0
    assert [one.update([-12345.0]) for _ in range(11)] == 10 * [0] + [1]  # which the stub cannot read
    assert one.published("health", "code") == 6
    assert one.published("health", "unseen.link_position") == 11
    assert math.isnan(one.published("measured", "link_position"))
    assert one.input() == 0.0
    assert one.update([0.0]) == 1  # it latches
    assert one.input() == 0.0
    assert one("deactivate") == 0
    assert one.activate([0.1]) == 0
    assert one.update([0.1]) == 0


def test_inputs_are_zero_after_a_fault_and_a_deactivation(
    arm: Callable[[], Manager], capfd: pytest.CaptureFixture[str]
) -> None:
    """A fault left the last voltage, and a deactivation did."""
    one = arm()
    assert one.configure() == 0
    assert one.activate([0.1]) == 0
    assert one.update([0.1]) == 0
    assert [one.update([math.nan]) for _ in range(10)] == [0] * 10
    assert one.input() != 0.0
    for y in (math.nan, *[0.7] * 6):
        assert one.update([y]) == 1
        assert one.input() == 0.0
    assert capfd.readouterr().err.count("ERROR") == 1
    assert one.activate([0.1]) == 0
    assert one.update([0.1]) == 0
    assert one.input() != 0.0
    assert one("deactivate") == 0
    assert one.input() == 0.0


def test_a_commanded_position_stays_where_it_is_measured(arm: Callable[[], Manager]) -> None:
    """As joint_trajectory_controller holds one; without a measurement it is the last one."""
    one = arm()
    assert one.configure(inputs__motor_voltage__interface="joint/position") == 0
    assert one.activate([0.1]) == 0
    for y in (0.1, *[math.nan] * 10):
        assert one.update([y]) == 0
    last = one.input()
    assert one.update([math.nan]) == 1
    assert one.input() == last
    assert one("deactivate") == 0
    assert one.activate([0.3]) == 0
    assert one.update([0.3]) == 0
    assert one("deactivate") == 0
    assert one.input() == 0.3


@pytest.mark.ci("links a program")
@pytest.mark.parametrize(("latency", "version"), [(0, "HUMBLE"), (1, "JAZZY")])
def test_no_update_allocates(
    latency: int, version: str, managed: Callable[..., Callable[[], Manager]], tmp_path: Path
) -> None:
    """Nor at the first message, with a path, or at the end: the stub's publisher copies, and its logger allocates."""
    built = managed(arm_controller(latency, start="bumpless"), version)().package.parent.parent
    objects = [built / f"{name}.o" for name in ("controller", "manager", "arm")]
    program = tmp_path / "allocations"
    subprocess.run(["g++", *STRICT, HERE / "allocations.cpp", *objects, "-lm", "-o", program], check=True)
    found = subprocess.run([program], check=True, capture_output=True, text=True)
    assert found.stdout.split() == ["9", "0"]
    assert found.stderr.count("ERROR") == 1


@pytest.mark.ci("3,400 samples of two joints with MuJoCo")
@pytest.mark.oracle
def test_a_path_of_a_workspace_is_followed_in_mujoco_and_braked_at_its_edge(
    managed: Callable[..., Callable[[], Manager]],
) -> None:
    pytest.importorskip("mujoco")
    robot, controller = robot_of("planar-two-link"), workspace_controller()
    sensors = ("link_position", "motor_position")
    manager = managed(controller)()
    assert manager.configure(publish_every=1) == 0
    begin = np.array([-0.4, 0.2])
    x, u = robot.operating_point(begin)

    def rows(goal: Sequence[float], time: float) -> np.ndarray:
        move = fh.Moving(
            [fh.Quintic(a, b, time) for a, b in zip(begin, goal, strict=True)], robot.inverse_dynamics
        )
        times = PERIOD * np.arange(round(time / PERIOD) + 1)
        return np.array([np.concatenate([move.state(t), move.input(t)]) for t in times])

    path = rows([0.1, -0.3], 0.6)
    states, inputs = driven(manager, MuJoCoPlant(robot, sensors), x, path, 900)
    expected = expected_loop(controller, MuJoCoPlant(robot, sensors), x, u, path, 900)
    assert_near(states, expected[0], 1e-7)
    assert_near(inputs, expected[1], 1e-5)
    assert states[-1][:2] == pytest.approx([0.1, -0.3], abs=5e-3)
    assert manager("deactivate") == 0

    states, inputs = driven(manager, MuJoCoPlant(robot, sensors), x, rows([0.9, 0.5], 0.8), 2500)
    assert manager.published("health", "outside_workspace") == 1
    assert manager.published("health", "path_rate") == 0
    assert manager.published("health", "reacting") == 1
    at = states[-1][:2]
    assert 0.3 < at[0] < 0.75
    assert np.abs(states[-1][2:4]).max() < 1e-2
    assert states[-1] == pytest.approx(robot.operating_point(at)[0], abs=5e-3)
    assert manager("deactivate") == 0
    states, _ = driven(
        manager, MuJoCoPlant(robot, sensors), robot.operating_point(at)[0], rows([0.9, 0.5], 0.8)[:1], 1
    )
    assert manager.published("health", "path_rate") == 1


@pytest.mark.ci("CMake builds the package")
def test_cmake_builds_the_package_against_packages_of_these_names(
    managed: Callable[..., Callable[[], Manager]], tmp_path: Path
) -> None:
    if shutil.which("cmake") is None:
        pytest.skip("missing: cmake")
    package = managed(arm_controller(0, start="bumpless"))().package
    names = [d.text for d in ElementTree.parse(package / "package.xml").getroot().iter("depend")]
    for name in ("ament_cmake", *names):
        folder = tmp_path / "prefix" / str(name)
        folder.mkdir(parents=True)
        text = f"include_directories({HERE / 'stubs'})\n"
        if name == "ament_cmake":
            text = "macro(ament_package)\nendmacro()\nfunction(ament_target_dependencies)\nendfunction()\n"
        if name == "pluginlib":
            text += (
                "function(pluginlib_export_plugin_description_file base file)\n"
                "if(NOT EXISTS ${CMAKE_CURRENT_SOURCE_DIR}/${file})\nmessage(FATAL_ERROR ${file})\nendif()\n"
                "endfunction()\n"
            )
        (folder / f"{name}-config.cmake").write_text(text)
    words = ["cmake", "-S", package, "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={tmp_path / 'prefix'}",
             f"-DCMAKE_INSTALL_PREFIX={tmp_path / 'installed'}"]  # fmt: skip
    subprocess.run([*words], check=True)
    subprocess.run(["cmake", "--build", tmp_path / "build", "--target", "install"], check=True)
    assert (tmp_path / "installed/lib/libarm_controller.so").exists()
    shared = tmp_path / "installed/share/arm_controller"
    for folder, ending in (("config", "yaml"), ("launch", "launch.py"), ("urdf", "urdf.xacro")):
        assert (shared / folder / f"arm_controller.{ending}").exists()
