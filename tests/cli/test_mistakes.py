"""What is wrong with a robot, or with an option of ``flexhinf design``, is told in three parts; nothing is written."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.cli.conftest import QUICK
from typer.main import get_command

from flexhinf.cli import main
from flexhinf.cli.commands import app
from flexhinf.designs.specification import FIELDS
from flexhinf.options import FieldInfo, option_name

BOTH = ["--set", "penalty=link_position=1,link_position_integral=1"]
URDF = """<robot name="r"><link name="base"/><link name="a"><inertial><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="elbow" type="continuous"><parent link="base"/><child link="a"/></joint></robot>"""


@pytest.mark.parametrize(
    ("replaced", "by", "what"),
    [
        ("stiffness = 100.0", "", "stiffness"),
        ("stiffness = 100.0", "stifness = 100.0", "stiffness"),
        ("stiffness = 100.0", "stiffness = -1.0", "> 0 N·m/rad"),
        ("stiffness = 100.0", "stiffness = 'soft'", "stiffness"),
        ("motor_inertia = 0.1", "motor_inertia = 0.0", "> 0 kg·m²"),
        ("motor_inertia = 0.1", "", "once"),
        ("xx = 0.01", "xx = -0.01", "[-0.01, 0.02, 0.02]"),
        ("xx = 0.01", "xx = 0.1", "[0.02, 0.02, 0.1]"),
        ("[[joint]]", "[[joint", "no TOML"),
    ],
)
def test_what_is_wrong_with_a_robot_is_told(
    replaced: str, by: str, what: str, arm: str, folder: Path, refused: Callable[..., str]
) -> None:
    (folder / "arm.toml").write_text(arm.replace(replaced, by), encoding="utf-8")
    refused(["design", "arm.toml"], what, folder)


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--pose", "2.0"], ("'elbow'", "-1 to 1 rad")),
        (["--start", "2.0"], ("'elbow'", "-1 to 1 rad")),
        (["--via", "0.1", "--via", "2.0"], ("'elbow'", "-1 to 1 rad")),
        (["--via", "0.1,0.2"], ("['elbow']", "(0.1, 0.2)")),
        (["--via", "there"], "['there']"),
        (["--pose", "0.1,0.2"], ("['elbow']", "(0.1, 0.2)")),
        (["--pose", "90grad"], ("pose", "deg", "'90grad'")),
        (["--preset", "smooth"], ("preset", "damped", "'smooth'")),
        (["--bandwidth", "4xyz"], ("rad/s > 0", "'4xyz'")),
        (["--bandwidth", "-4"], "bandwidth"),
        (["--bandwidth", "0Hz"], "rad/s > 0"),
        (["--bandwidth", "nan"], "rad/s > 0"),
        (["--bandwidth", "4,6"], ("bandwidth", "[4.0, 6.0]")),
        (["--damping", "2"], "damping"),
        (["--damping", "-0.1"], "damping"),
        (["--damping", "high"], "--damping"),
        (["--peak-effort", "-60"], ("(V, A, N·m or N)", "try:   --peak-effort 60")),
        (["--peak-effort", "60mV"], ("driven by torque", "N·m", "'60mV'", "try:   --peak-effort in N·m")),
        (["--saturation", "48V"], ("driven by torque", "N·m", "'48V'", "try:   --saturation in N·m")),
        (["--saturation", "24kV"], ("(V, A, N·m or N)", "'24kV'")),
        (["--latency", "1ms"], ("samples", "--period", "'1ms'", "try:   --latency 1")),
        (["--overshoot", "5%"], ("(%)", "try:   --overshoot 5")),
        (["--overshoot", "-5"], "overshoot"),
        (["--overshoot", "0"], "overshoot"),
        (["--unknown-delay", "-1e-3"], "unknown-delay"),
        (["--unknown-delay", "5"], "--unknown-delay 5ms"),
        (["--duration", "-3"], ("duration", "> 0, s")),
        (["--duration", "5000"], "5000000 samples"),
        (["--quantisation", "-1"], "quantisation"),
        (["--quantisation", "inf"], "quantisation"),
        (["--set", "load=nan"], "load"),
        (["--set", "load=heavy"], "--set load"),
        (["--draws", "-3"], "draws"),
        (["--draws", "many"], "--draws"),
        (["--torque-noise", "-1"], "torque noise"),
        (["--preset", "paper", "--bandwidth", "4"], ("--preset paper", "--bandwidth", "contradict")),
        (["--preset", "paper", *BOTH], ("--preset paper", "--set penalty", "contradict")),
        (["--preset", "damped", *BOTH], ("--preset damped", "--set penalty", "contradict")),
        (["--preset", "robust", "--set", "effort=3"], ("--preset robust", "--set effort", "contradict")),
        ([*BOTH, "--bandwidth", "1"], "contradict"),
        ([*BOTH, "--damping", "0.3"], "contradict"),
        (["--preset", "robust"], ("'arm'", "robust", "tolerance")),
        (["--degrees", "two"], ("2 to 12", "'two'")),
        (["--degrees", "1"], "degrees"),
        (["--set", "penalty=1,2,3"], "penalty"),
        (["--set", "penalty=link_positon=1"], "try:   'link_position'"),
        (["--set", "penalty=joint_torqe=1"], "try:   'joint_torque'"),
        (["--set", "penalty=linkk=3"], "try:   'link_position'"),
        (
            ["--set", "penalty=link_position=-60,link_position_integral=300"],
            ("'link_position'", "-60.0"),
        ),
        (["--pose", "90", "deg"], ("(deg)", "'90 deg'")),
        (["--unknown-delay", "5", "ms"], ("(ms)", "'5 ms'")),
        (["--set", "penalty=link_position=a"], "'link_position=a'"),
        (["--set", "gamma_ratio=0.5"], "gamma ratio"),
        (["--set", "gamma_ratio=1", "--preset", "paper"], "gamma ratio"),
        pytest.param(
            ["--set", "rays=10", "--degrees", "2", "--set", "checked_gamma_ratio=1.2"],
            ("92.0694", "73.655"),
            marks=pytest.mark.ci("solves for the law first"),
        ),
        (["--set", "effort=-1"], "effort"),
        (["--measured", "colour"], "colour"),
        (["--measured", "motor_positon"], ("'motor_positon'", "try:   --measured motor_position")),
        (["--measured", "load_cell"], ("'load_cell'", "load cell", "joint_torque")),
        (["--measured", "joint_torque_hip"], ("joint_torque_hip", "'elbow'")),
        (["--set", "disturbances=wind"], "wind"),
        (["--extras", "rust"], "rust"),
        (["--extras", "backlash"], "backlash"),
        (["--estimator", "kalman"], "observer"),
        (["--saturation", "-3"], "saturation"),
        (["--period", "0"], "period"),
        (["--elastic", "arm.toml"], "elastic"),
        (["--colour", "red"], "--colour"),
        (["--goal", "0.1"], ("--goal ", "try:   --pose ")),
        (["--goal-xyz=0.1,0,0"], ("--goal-xyz ", "try:   --pose-xyz ")),
        (["--from-pose", "-0.1"], ("--from-pose ", "try:   --start ")),
        (["--friction"], ("--friction ", "try:   --set friction_model=yes")),
        (["--no-friction"], ("--no-friction ", "try:   --set friction_model=no")),
        (["--dead-zone", "0"], ("--dead-zone ", "try:   --set integral_dead_zone=0")),
    ],
    ids=lambda words: " ".join(words) if isinstance(words, list) else "",
)
def test_what_is_wrong_with_an_option_is_told(
    words: list[str], what: str | tuple[str, ...], arm: str, folder: Path, refused: Callable[..., str]
) -> None:
    (folder / "arm.toml").write_text(arm, encoding="utf-8")
    pose = [] if "--pose" in words else ["--pose", "home"]
    refused(["design", "arm.toml", *pose, *words], what, folder)


def test_degrees_without_their_unit_are_asked_about(folder: Path, refused: Callable[..., str]) -> None:
    assert "degrees" in refused(["design", "paper", "--pose", "90"], ("'joint'", "90deg"), folder)


@pytest.mark.parametrize(
    ("goal", "limits"),
    [
        ("5000deg", "-57.2958 to 57.2958 deg"),
        ("50rad", "-1 to 1 rad"),
        ("5000", "-1 to 1 rad"),
    ],
)
def test_advice_on_a_pose_follows_its_unit_and_the_limits(
    goal: str, limits: str, arm: str, folder: Path, refused: Callable[..., str]
) -> None:
    """Old code asked whether degrees were meant where they were given, and for limits that the file states."""
    (folder / "arm.toml").write_text(arm)
    told = refused(["design", "arm.toml", "--pose", goal], ("'elbow'", limits, f"got {goal}"), folder)
    assert "degrees" not in told
    told = refused(["design", "arm.toml", "--pose", "50"], ("'elbow'", "-1 to 1 rad"), folder)
    assert "degrees" in told
    told = refused(
        ["design", "paper", "--pose", "500deg"], ("'joint'", "-360 to 360 deg", "got 500deg"), folder
    )
    assert "degrees" not in told


@pytest.mark.parametrize(
    "words",
    [
        ["export", "c"],
        ["export", "fmu"],
        ["export", "fmu", "--plant"],
        ["compile"],
        ["run"],
        ["run", "--mujoco"],
        ["design"],
        ["compare"],
        ["certify"],
        ["campaign"],
        ["campaign", "run"],
    ],
    ids=" ".join,
)
@pytest.mark.parametrize("name", ["nosuch.toml", "nosuch", "empty"])
def test_a_design_that_is_not_there_is_told_as_such(
    words: list[str], name: str, folder: Path, refused: Callable[..., str]
) -> None:
    """Old code took it for a controller's file, and advised to save it again."""
    (folder / "empty").mkdir()
    told = refused([*words, name], "expected", folder)
    assert f"'{name}'" in told
    assert "save" not in told
    assert "design" in told


@pytest.mark.parametrize(
    "words",
    [
        ["certify", "--check"],
        ["design", "paper", "--draws"],
        ["compare", "paper", "--laws"],
        ["campaign", "compare", "a", "b", "--samples"],
        ["export", "c", "x", "--out"],
        ["export", "c"],
        ["run", "--mujoco=3", "x"],
        ["paper", "--out"],
        ["robots", "more"],
    ],
    ids=" ".join,
)
def test_a_mistake_in_the_options_names_the_help_of_its_command(
    words: list[str], folder: Path, refused: Callable[..., str]
) -> None:
    """Old code named the help of all commands where a value was missing."""
    path = " ".join(words[:2] if words[0] in ("campaign", "export") else words[:1])
    told = refused(words, f"`flexhinf {path} --help", folder)
    assert f"try:   flexhinf {path} --help" in told


SETTINGS = [field for field in FIELDS.values() if field.about.setting]


@pytest.mark.parametrize("field", SETTINGS, ids=lambda field: field.name)
def test_a_setting_that_is_typed_as_an_option_is_told_how_it_is_stated(
    field: FieldInfo, folder: Path, refused: Callable[..., str]
) -> None:
    """The advice is followed: with it the mistake is another one."""
    flag = isinstance(field.default, bool)
    typed = option_name(field.name)
    told = refused(["design", "paper", typed, *([] if flag else [field.about.example])], typed, folder)
    advice = told.split("try:")[1].split()
    assert advice == ["--set", f"{field.name}={'yes' if flag else field.about.example}"]
    refused(["design", "paper", *advice, "--draws", "many"], "--draws", folder)


@pytest.mark.parametrize("drive", ["voltage", "current", "torque"])
def test_the_peaks_of_earlier_versions_have_one_name(
    drive: str, folder: Path, refused: Callable[..., str]
) -> None:
    words = ["design", "paper", f"--peak-{drive}", "24"]
    assert "--peak-effort" in refused(words, f"--peak-{drive}", folder).split("try:")[1]


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("rays", "expected a name and a value"), ("ray=5", "--set rays=5"), ("draws=5", "--draws 5"),
        ("feedforward=maybe", "--set feedforward=no"), ("", "expected a name and a value"),
    ],
)  # fmt: skip
def test_a_setting_that_is_none_is_told(
    text: str, what: str, folder: Path, refused: Callable[..., str]
) -> None:
    refused(["design", "paper", "--set", text], what, folder)
    refused(["design", "paper", "--set", "rays=1", "--set", "rays=2"], "twice", folder)


@pytest.mark.parametrize(
    "words", [["--pose", "90deg"], ["--start", "-90deg"], ["--via", "20deg", "--via", "90deg"]]
)
def test_a_pose_that_the_motor_cannot_hold_is_told(
    words: list[str], folder: Path, refused: Callable[..., str]
) -> None:
    pose = [] if "--pose" in words else ["--pose", "home"]
    refused(["design", "paper", "--peak-effort", "6", *pose, *words], ("'joint'", "6 V"), folder)


@pytest.mark.parametrize(
    ("urdf", "elastic", "what"),
    [
        ("solid arm; endsolid", "", "no XML"),
        ("<solid/>", "", "no URDF"),
        (URDF, None, "elastic"),
        (URDF, "elbov", "'elbow'"),
        (URDF.replace("<inertial>", "<!--").replace("</inertial>", "-->"), "", "inertia"),
    ],
    ids=["no XML", "no URDF", "no elastic data", "unknown joint", "no inertials"],
)
def test_what_is_wrong_with_a_urdf_is_told(
    urdf: str, elastic: str | None, what: str, arm: str, folder: Path, refused: Callable[..., str]
) -> None:
    (folder / "arm.urdf").write_text(urdf, encoding="utf-8")
    lines = arm.replace("elbow", elastic or "elbow").splitlines()
    kept = [
        line for line in lines if not line.startswith(("mass", "centre", "inertia", "limits", "[joint.l"))
    ]
    (folder / "joints.toml").write_text("\n".join(kept), encoding="utf-8")
    beside = [] if elastic is None else ["--elastic", "joints.toml"]
    refused(["design", "arm.urdf", *beside, *QUICK], what, folder)


def test_a_robot_that_is_nowhere_is_told_with_the_nearest(folder: Path, refused: Callable[..., str]) -> None:
    refused(["design", "seven-links", *QUICK], "'seven-link'", folder)


def test_a_design_with_a_misspelt_name_is_told_the_one_beside_it(
    folder: Path, refused: Callable[..., str]
) -> None:
    (folder / "flexhinf-design").mkdir()
    (folder / "flexhinf-design" / "design.toml").write_text("[design]\nrobot = 'paper'\n", encoding="utf-8")
    for words in (["export", "c"], ["export", "web"], ["run", "--mujoco"]):
        refused([*words, "flexhinf-desing"], ("'flexhinf-desing'", "try:   flexhinf-design"), folder)


def test_a_folder_that_is_no_report_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    assert main(["design", "paper", "--pose", "home", *QUICK, "--out", str(tmp_path)]) == 2
    assert "flexhinf-report.json" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    "words", [["design", "paper", "--pose", "\udcff"], ["design", "\udcff"], ["paper", "--out", "\udcff"]]
)
def test_words_that_are_no_text_are_refused(
    words: list[str], folder: Path, refused: Callable[..., str]
) -> None:
    refused(words, "UTF-8", folder)


def test_a_pipe_is_no_robot(folder: Path, refused: Callable[..., str]) -> None:
    os.mkfifo(folder / "arm.toml")
    refused(["design", "arm.toml"], ("'arm.toml'", "catalogue"), folder)


def paths_of(command: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str]]:
    """Words of every command, and its options and arguments that are paths."""
    for name, inner in getattr(command, "commands", {}).items():
        yield from paths_of(inner, (*words, name))
    declared = getattr(inspect.unwrap(command.callback), "options", {}) if words and command.callback else {}
    for parameter in command.params:
        if parameter.name in declared and declared[parameter.name].is_path:
            yield words, parameter.opts[0] if parameter.param_type_name == "option" else ""


PATHS = list(paths_of(get_command(app)))


def test_every_command_that_writes_has_a_path() -> None:
    found = {" ".join((*words, option)) for words, option in PATHS}
    assert found >= {
        "run --log", "run --record", "run --library", "compile --out", "export c --out", "export fmu --out",
        "design --out", "compare --out", "certify --out", "certify --check", "paper --out",
        "campaign run --out", "campaign compare --out", "campaign merge ",
    }  # fmt: skip


@pytest.mark.parametrize(
    "words",
    [
        ["compile"],
        ["export", "c"],
        ["export", "fmu"],
        ["run", "--mujoco"],
        ["design"],
        ["compare"],
        ["campaign", "run"],
    ],
)
def test_an_empty_design_is_not_that_of_the_working_folder(
    words: list[str], folder: Path, refused: Callable[..., str]
) -> None:
    (folder / "design.toml").write_text("")
    refused([*words, ""], ("pathlib.Path", "got ''"), folder)


@pytest.mark.parametrize(("words", "option"), PATHS)
def test_an_empty_path_is_no_path(
    words: tuple[str, ...], option: str, folder: Path, refused: Callable[..., str]
) -> None:
    """Python takes "" for the folder ".": a log of that name was a traceback, a campaign there the working folder."""
    (folder / "design.toml").write_text("")
    for given in ((option, ""), (f"{option}=",)) if option else (("",),):
        count = {("paper",): 0, ("campaign", "compare"): 2}.get(words, 1) if option else 0
        before = ("paper",) * count
        refused([*words, *before, *given], ("pathlib.Path", "got ''", option), folder)
