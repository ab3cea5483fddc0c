"""A design file says what was asked for, whole; what is wrong with one is told with the key and what is allowed."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.designs import Specification, design_schema, read_request
from flexhinf.designs.design_file import is_design_file, read_tables, request_document
from flexhinf.designs.fields import resolved
from flexhinf.designs.requirements import limit_fields
from flexhinf.designs.specification import FIELDS
from flexhinf.plant import Penalty

#: For every field, a value that is not its default; nothing here fits one robot.
OTHERS: dict[str, Any] = {
    "pose": (0.1, -1 / 3),
    "start": (0.1 + 0.2, 1e-17),
    "workspace": {"time": [0.0, 1.0], "shoulder": [0.0, 1 / 3], "elbow": [0.5, 0.1 + 0.2]},
    "law": "lqg",
    "via": ((0.1, 0.2), (0.3, np.pi)),
    "preset": "robust",
    "bandwidth": (4.0, 2 * np.pi * 0.6),
    "damping": 0.1 + 0.2,
    "peak_effort": (60.0, np.inf),
    "peak_speed": (1.5, 2.0),
    "angle_unit": "deg",
    "shaping": "quintic",
    "feedforward": False,
    "move": {"time": [0.0, 0.1 + 0.2], "shoulder": [0.0, 1 / 3], "elbow": [0.5, 0.1]},
    "friction_model": True,
    "integral_dead_zone": (1e-3, 5e-4),
    "penalty": {"link_position": (60.0, 1 / 3), "link_position_integral": 300.0},
    "damped_below": 2 * np.pi * 50.1,
    "effort": (10.0, 1 / 3),
    "gamma_ratio": 1.7,
    "checked_gamma_ratio": 1.9,
    "checked_penalty": (54.0, 0.0, 1e-9),
    "degrees": (2, 6),
    "measured": ("motor_position", "joint_torque_elbow"),
    "disturbances": ("link_torque", "motor_torque"),
    "command": True,
    "estimator": "observer",
    "period": 5e-4,
    "process_noise": 1e-11,
    "torque_noise": 3e-8,
    "measurement_noise": 1e-300,
    "saturation": (24.0, 12.0),
    "extras": ("inductance", "coulomb_friction"),
    "latency": 2,
    "unknown_delay": 1e-3,
    "quantisation": (2 * np.pi / 4096, 0.0),
    "load": -0.7,
    "draws": 0,
    "rays": 0,
    "duration": 5.0,
    "seed": 2**40,
    "proof_seconds": 2.5,
    "mujoco": True,
}


OTHERS |= {name: field.read(field.about.example) for name, field in limit_fields().items()}
OTHERS |= {
    "tracking_error": (0.01, 1 / 3),
    "undershoot": 1 / 3,
}  # one for each joint, and what no text has whole


def names() -> list[str]:
    own = [field.name for field in dataclasses.fields(Specification) if field.name != "limits"]
    return [*own, *limit_fields()]


def written(folder: Path, specification: Specification, **places: Any) -> Path:
    file = folder / "design.toml"
    file.write_text(
        tomlkit.dumps(request_document(specification, **{"robot": "paper", **places}, folder=folder)),
        encoding="utf-8",
    )
    return file


def stated(file: Path) -> tuple[fh.Robot, Specification]:
    """Robot and specification that a design file states, which need not fit each other."""
    places, fields = read_tables(file)
    return fh.load_robot(places["robot"], payload=places.get("payload")), Specification(**fields)


def test_a_file_can_hold_every_field_of_a_specification() -> None:
    assert set(FIELDS) == set(names()) == set(OTHERS)
    default = Specification()
    assert [name for name in names() if OTHERS[name] == getattr(default, name)] == []


@pytest.mark.parametrize("name", names())
def test_each_field_comes_back(name: str, tmp_path: Path) -> None:
    asked = Specification(**{name: OTHERS[name]})
    file = written(tmp_path, asked)
    _, read = stated(file)
    assert read == asked
    assert set(tomllib.loads(file.read_text(encoding="utf-8"))["design"]) == {"robot", name}


def test_all_fields_come_back_together(tmp_path: Path) -> None:
    asked = Specification(**OTHERS)
    assert stated(written(tmp_path, asked))[1] == asked


def test_nothing_asked_is_nothing_written_but_the_defaults_stand_there(tmp_path: Path) -> None:
    file = written(tmp_path, Specification())
    robot, read = stated(file)
    assert (robot.name, read) == ("paper", Specification())
    text = file.read_text(encoding="utf-8")
    assert tomllib.loads(text) == {"design": {"robot": "paper"}}
    lines = text.split("# By default:")[1].splitlines()
    commented = tomllib.loads("\n".join(line.removeprefix("# ") for line in lines))
    for name, value in commented.items():
        default = getattr(Specification(), name)
        assert value == (list(default) if isinstance(default, tuple) else default), name


def test_every_example_of_a_field_can_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "waypoints.csv").write_text("time,shoulder\n0,0\n1,0.5\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for name, field in FIELDS.items():
        text: Any = field.about.example or True
        Specification(**{name: text})
        assert (field.about.example == "") == isinstance(field.default, bool)


def test_the_schema_has_every_field_with_its_help() -> None:
    table = design_schema()["properties"]["design"]
    assert list(table["properties"]) == ["robot", "elastic", "payload", *FIELDS]
    assert table["additionalProperties"] is False
    assert table["properties"]["preset"]["anyOf"][0]["enum"] == ["paper", "damped", "robust", "proved"]
    assert table["properties"]["overshoot"]["anyOf"][0]["exclusiveMinimum"] == 0.0
    for name, field in FIELDS.items():
        assert field.about.help in table["properties"][name]["description"]


def test_texts_with_units_are_read_and_degrees_are_kept(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(
        "[design]\nrobot = 'paper'\npose = '90°'\nbandwidth = '0.6Hz'\nunknown_delay = '5ms'\n",
        encoding="utf-8",
    )
    _, read = stated(tmp_path / "mine.toml")
    assert (read.pose, read.unknown_delay, read.in_degrees) == ((np.pi / 2,), 5e-3, True)
    file = written(tmp_path, read)
    assert "pose = [1.5707963267948966] # 90°" in file.read_text(encoding="utf-8")
    assert stated(file)[1] == read
    assert not Specification(pose=(0.5,)).in_degrees


def test_metres_are_not_shown_as_degrees() -> None:
    """Of a robot whose first joint slides."""
    s = Specification(pose="30mm,10deg", via=[(0.01, 0.1)], tracking_error="0.01", angle_unit="deg")  # type: ignore[arg-type]
    text = tomlkit.dumps(request_document(s, "paper", slides=(True, False)))
    assert "# 0.03 m, 10°" in text
    assert "# 0.01 m, 5.72958°" in text
    assert "tracking_error = [0.01] # rad, m" in text


def test_arrays_and_penalties_of_python_are_written_too(tmp_path: Path) -> None:
    asked = Specification(
        pose=np.array([0.5]), bandwidth=np.float64(3.0), penalty=Penalty({"link_position": 60.0}, 10.0)
    )
    _, read = stated(written(tmp_path, asked))
    assert (read.pose, read.bandwidth) == ((0.5,), 3.0)
    assert (read.penalty, read.effort) == ({"link_position": 60.0}, 10.0)
    rows = np.array([[1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 2.0]])
    _, read = stated(written(tmp_path, Specification(penalty=rows)))
    assert np.array_equal(np.asarray(Penalty.of(read.penalty).matrix), rows)


def test_the_waypoints_of_a_move_are_found_from_the_folder_of_the_design_file(tmp_path: Path) -> None:
    (tmp_path / "way.csv").write_text("time [ms],joint [deg]\n100,0\n600,90\n", encoding="utf-8")
    (tmp_path / "mine.toml").write_text("[design]\nrobot = 'paper'\nmove = 'way.csv'\n", encoding="utf-8")
    _, read = stated(tmp_path / "mine.toml")
    assert read.move.columns() == {"time": [0.0, 0.5], "joint": [0.0, pytest.approx(np.pi / 2)]}
    with pytest.raises(fh.InvalidInput, match="move"):
        request_document(Specification(move=fh.Spline([0.0, 1.0], [0.0, 1.0])), "paper")


@pytest.mark.parametrize("penalty", [lambda x, p: x, Penalty({"link_position": 1.0}, np.diag([1.0, 2.0]))])
def test_what_a_file_cannot_hold_is_refused(penalty: Any, tmp_path: Path) -> None:
    with pytest.raises(fh.InvalidInput, match="design file"):
        request_document(Specification(penalty=penalty), "paper")


def test_paths_are_seen_from_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robots, report = tmp_path / "my robots", tmp_path / "out" / "report"
    robots.mkdir()
    report.mkdir(parents=True)
    (robots / "arm.toml").write_bytes(fh.catalogue()["vertical-rig"].read_bytes())
    monkeypatch.chdir(tmp_path)
    file = written(report, Specification(seed=3), robot="my robots/arm.toml")
    assert 'robot = "../../my robots/arm.toml"' in file.read_text(encoding="utf-8")
    monkeypatch.chdir(robots)
    assert stated(file)[0].joint_names == fh.load_robot("vertical-rig").joint_names
    again = read_request(Path("..") / "out" / "report" / "design.toml")
    assert Path(again.source).resolve() == (robots / "arm.toml").resolve()
    assert again.specification.seed == 3


def test_what_is_given_wins_over_the_file_and_nothing_takes_back(tmp_path: Path) -> None:
    file = written(tmp_path, Specification(pose="home", bandwidth=4.0, damping=0.3, saturation=24.0))
    asked = read_request(file, settings={"bandwidth": 5.0, "saturation": None, "seed": 7})
    left = Specification(pose="home", bandwidth=5.0, damping=0.3, seed=7)
    assert asked.specification == resolved(asked.robot, left)
    assert asked.notes == ()


@pytest.mark.parametrize(
    ("file", "given", "left"),
    [
        ({"preset": "damped", "bandwidth": 4.0}, {"penalty": (1.0,)}, {"penalty": (1.0,)}),
        ({"preset": "paper", "effort": 3.0}, {"effort": 4.0}, {"preset": "paper", "effort": 4.0}),
        ({"preset": "robust", "damping": 0.3}, {"effort": 4.0}, {"effort": 4.0}),
        ({"preset": "paper", "effort": 3.0}, {"damping": 0.3}, {"damping": 0.3}),
        ({"penalty": (1.0,), "effort": 3.0}, {"bandwidth": 4.0}, {"bandwidth": 4.0}),
        ({"penalty": (1.0,), "effort": 3.0}, {"preset": "damped"}, {"preset": "damped"}),
        ({"bandwidth": 4.0, "effort": 3.0}, {"preset": "paper"}, {"preset": "paper", "effort": 3.0}),
        ({"preset": "damped", "bandwidth": 4.0}, {"preset": "robust"}, {"preset": "robust", "bandwidth": 4.0}),
        ({"bandwidth": 4.0}, {"penalty": None}, {"bandwidth": 4.0}),
    ],
)  # fmt: skip
def test_what_contradicts_it_in_the_file_gives_way(
    file: dict[str, Any], given: dict[str, Any], left: dict[str, Any], tmp_path: Path
) -> None:
    asked = read_request(written(tmp_path, Specification(pose="home", **file)), settings=given)
    assert asked.specification == resolved(asked.robot, Specification(pose="home", **left))
    gone = {name for name in file if name not in left and name not in given}
    assert {note.split()[1] for note in asked.notes} == gone


def test_a_robot_is_no_design_file(tmp_path: Path) -> None:
    for name, path in fh.catalogue().items():
        assert not is_design_file(name)
        assert not is_design_file(path)
    (tmp_path / "design.toml").write_text("[design", encoding="utf-8")
    assert not is_design_file(tmp_path / "design.toml")
    asked = read_request("vertical-rig", settings={"seed": 2})
    assert (asked.source, asked.elastic, asked.specification.seed) == ("vertical-rig", None, 2)


@pytest.mark.parametrize(
    ("text", "what", "found", "advice"),
    [
        ("[design]\nrobot = 'paper'\nbandwith = 4", "'bandwith'", "bandwidth", "'bandwidth'"),
        ("[design]\nrobot = 'paper'\ncolour = 4", "'colour'", "damping", "one of these"),
        ("[desing]\nrobot = 'paper'", "table [design]", "desing", "[design] for 'desing'"),
        ("design = 3", "table [design]", "'design'", "robot = 'arm.toml'"),
        ("[found]\ngamma = 3", "table [design]", "'found'", "robot = 'arm.toml'"),
        ("[design]\nrobot = 'paper'\n[resutl]\n", "'resutl'", "result", "'result'"),
        ("[design]\nseed = 3", "no 'robot'", "seed", "planar-two-link"),
        ("[design]\nrobt = 'paper'", "no 'robot'", "robt", "'robot' for 'robt'"),
        ("[design]\nrobot = 'papr'", "robot 'papr'", "catalogue", "'paper'"),
        ("[design]\nrobot = 'arm.toml'", "robot 'arm.toml'", "design.toml", "path"),
        ("[design]\nrobot = 4", "'robot'", "text, got 4", "arm.toml"),
        ("[design]\nrobot = 'paper'\nelastic = 'j.toml'", "elastic 'j.toml'", "file", "path"),
        ("[design]\nrobot = 'paper'\ndamping = 'high'", "'damping'", "0 to 1, got 'high'", "damping = 0.3"),
        ("[design]\nrobot = 'paper'\ndamping = true", "'damping'", "0 to 1, got True", "damping = 0.3"),
        ("[design]\nrobot = 'paper'\ndamping = nan", "'damping'", "0 to 1, got nan", "damping = 0.3"),
        ("[design]\nrobot = 'paper'\ndamping = 2", "'damping'", "0 to 1, got 2", "damping = 0.3"),
        ("[design]\nrobot = 'paper'\nbandwidth = '4Hy'", "'bandwidth'", "rad/s", "bandwidth = 4.0"),
        ("[design]\nrobot = 'paper'\nbandwidth = []", "'bandwidth'", "rad/s", "bandwidth = 4.0"),
        ("[design]\nrobot = 'paper'\npreset = 'dampd'", "'preset'", "damped, robust", "damped"),
        ("[design]\nrobot = 'paper'\nvia = [0.1]", "'via'", "poses (rad, m), got [0.1]", "[[0.1"),
        ("[design]\nrobot = 'paper'\nseed = 1.5", "'seed'", "below 2^63, got 1.5", "seed = 0"),
        ("[design]\nrobot = 'paper'\ndegrees = 4", "'degrees'", "2 to 12", "[2, 4]"),
        ("[design]\nrobot = 'paper'\ndegrees = [1]", "'degrees'", "from 2 to 12", "[2, 4]"),
        ("[design]\nrobot = 'paper'\nmeasured = 3", "'measured'", "names, got 3", "motor_position"),
        ("[design]\nrobot = 'paper'\ncommand = 1", "'command'", "false, got 1", "command = true"),
        ("[design]\nrobot = 'paper'\npenalty = 3", "'penalty'", "weights", "design.penalty"),
        ("[design]\nrobot = 'paper'\n[design.penalty]\nq = 'a'", "'penalty'", "'a'", "design.p"),
        ("[design]\nrobot = 'paper'\npenalty = [[1, 2], [3]]", "'penalty'", "rows", "design.penalty"),
        ("[design]\nrobot = 'paper'\nperiod = 2", "'period'", "1e-5 to 0.1 s", "period = \"2ms\""),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_file_is_told(
    text: str, what: str, found: str, advice: str, tmp_path: Path
) -> None:
    file = tmp_path / "design.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(fh.InvalidInput) as caught:
        read_request(file) if is_design_file(file) else stated(file)
    assert caught.value.what.startswith("design.toml: ")
    assert what in caught.value.what
    assert found in caught.value.found
    assert advice in caught.value.advice
    with pytest.raises(fh.InvalidInput, match=r"design\.toml"):
        stated(file)


def test_what_is_no_file_or_no_toml_is_told(tmp_path: Path) -> None:
    for nowhere in (tmp_path / "nowhere.toml", tmp_path):
        with refused_with(fh.InvalidInput, nowhere.name, "flexhinf design ROBOT --out DIR"):
            fh.load_design(nowhere)
    (tmp_path / "design.toml").write_bytes(b"[design]\nrobot = '\xff'")
    with refused_with(fh.InvalidInput, "TOML", "UTF-8", "0xff"):
        stated(tmp_path / "design.toml")
    with refused_with(fh.InvalidInput, "[design]"):
        stated(fh.catalogue()["paper"])


def test_a_payload_of_the_command_line_stands_in_the_file_and_wins_over_it(tmp_path: Path) -> None:
    file = tmp_path / "design.toml"
    file.write_text(
        tomlkit.dumps(request_document(Specification(), "paper", None, tmp_path, "0..0.2kg")),
        encoding="utf-8",
    )
    asked = read_request(file)
    assert asked.payload == "0..0.2kg"
    assert asked.robot["payload_mass"].interval == (0.0, 0.2)
    assert stated(file)[0]["payload_mass"].interval == (0.0, 0.2)
    assert read_request(file, payload="0.1").robot["payload_mass"].interval == (0.1, 0.1)
    assert read_request("paper", payload="0.1").robot.nominal["payload_mass"] == 0.1
