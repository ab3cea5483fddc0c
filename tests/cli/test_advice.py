"""What a refusal of an option advises works: it is read, applied to the command, and the command goes on."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import pytest
from tests.builders import joint_text
from tests.refusals import Anchor, unnamed

import flexhinf as fh
from flexhinf.cli import main
from flexhinf.designs import pipeline
from flexhinf.designs.responses import joint_limits
from flexhinf.designs.synthesis import steps
from flexhinf.designs.workspace import design

#: Two joints, so that sensors of one differ from those of all; driven by currents.
CURRENT = "".join(
    joint_text(
        name, axis=[0, 1, 0], xyz=[0.0, 0.0, 0.2], limits=[-1.0, 1.0], spring="stiffness = 800.0",
        motor="motor_inertia = 0.2\nfriction = 0.5\ntorque_constant = 9.0",
    )
    for name in ("shoulder", "elbow")
)  # fmt: skip


class Started(Exception):
    """A design begins: nothing that was asked for is wrong."""


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--saturation", "48V"], ("current", "A", "'48V'", "--saturation in A")),
        (["--saturation", "-10"], ("'-10'",)),
        (["--saturation", "24kV"], ("'24kV'", "--saturation 24000V")),
        (["--peak-effort", "48V,10A"], ("current", "'48V'", "--peak-effort in A")),
        (["--peak-effort", "48V"], ("current", "'48V'", "--peak-effort in A")),
        (["--peak-speed", "2m/s"], ("rad/s", "'2m/s'")),
        (["--measured", "link_position_shoulder,motor_velocity"], ("elbow", "motor_position_elbow")),
        (["--measured", "motor_positon"], ("--measured motor_position",)),
        (["--measured", "joint_torque"], ("sensor",)),
        (["--latency", "1ms"], ("samples",)),
        (["--unknown-delay", "5"], ("5ms",)),
        (["--period", "1"], ("0.1 s",)),
        (["--workspace", "-50:50,-50:50"], ("-50deg:50deg",)),
        (["--workspace", "-50deg:50deg"], ("2 joints",)),
        (["--pose", "45,45"], ("45deg",)),
        (["--pose", "0.1"], ("['shoulder', 'elbow']",)),
        (["--goal", "0.1,0.1"], ("--pose",)),
        (["--overshoot", "5%"], ("%",)),
        (["--payload", "0..1kg@tool"], ("'tool'", "@elbow")),
    ],
    ids=lambda words: " ".join(words) if isinstance(words, list) else "",
)
def test_advice_on_an_option_works(
    words: list[str],
    named: tuple[Anchor, ...],
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def started(*arguments: object) -> None:
        raise Started

    monkeypatch.setattr(design, "selected_law", started)
    monkeypatch.setattr(steps._Steps, "synthesis", started)
    (folder / "arm.toml").write_text(CURRENT, encoding="utf-8")
    told: list[str] = []
    while True:
        try:
            code = main(["design", "arm.toml", *words])
        except Started:
            break
        message = capsys.readouterr().err
        assert code == 2, message
        assert message not in told, message
        told.append(message)
        words = followed(message, words)
    assert unnamed("".join(told[:1]), *named) == [], told


@pytest.mark.parametrize("limited", ["option", "file"])
def test_a_design_says_before_its_minutes_what_an_export_will_ask_for(
    limited: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Either advice leaves nothing to say, and the limits are those of the design."""
    begun: list[fh.Robot | fh.Specification] = []

    def started(robot: fh.Robot, specification: fh.Specification, *more: object) -> None:
        begun[:] = robot, specification
        raise Started

    monkeypatch.setattr(sys.modules["flexhinf.designs"], "design_with", started)
    (folder / "arm.toml").write_text(CURRENT, encoding="utf-8")
    with pytest.raises(Started):
        main(["design", "arm.toml"])
    said = " ".join(capsys.readouterr().err.split())
    assert said.startswith("note: ")
    assert unnamed(said, "export c", "motor_current_shoulder", "motor_current_elbow", "in A") == []
    advised = {name: re.search(rf"{name}[ =]+([\d.]+)", said) for name in ("--saturation", "effort_limit")}
    assert all(advised.values()), said
    number = advised["--saturation" if limited == "option" else "effort_limit"][1]  # type: ignore[index]
    if limited == "file":
        key = f"[[joint]]\neffort_limit = {number}"
        (folder / "arm.toml").write_text(CURRENT.replace("[[joint]]", key), encoding="utf-8")
    with pytest.raises(Started):
        main(["design", "arm.toml", *(["--saturation", number] if limited == "option" else [])])
    assert "export" not in capsys.readouterr().err
    limits = joint_limits(*begun).saturated
    assert limits is not None
    assert limits.tolist() == [float(number)] * 2


@pytest.mark.parametrize("command", ["campaign run ws/runs", "campaign merge"])
def test_advice_on_a_folder_of_another_kind_works(
    command: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A workspace where one pose is looked at, and the folder of a campaign."""

    def started(*arguments: object) -> None:
        raise Started

    for room in (design, pipeline):
        monkeypatch.setattr(room, "selected_law", started)
    monkeypatch.setattr(steps._Steps, "synthesis", started)
    one = f"[[joint]]{CURRENT.split('[[joint]]')[1]}"
    loose = one.replace("stiffness = 800.0", "stiffness = {value = 800.0, tolerance = 10}")
    (folder / "arm.toml").write_text(loose, encoding="utf-8")
    document = '[design]\nrobot = "{}arm.toml"\n{}\n'
    for place, text in (
        ("ws", document.format("../", 'workspace = "limits"')),
        ("one", document.format("../", 'pose = "0.5"')),
        ("ws/runs/setup", document.format("../../../", 'pose = "0.5"')),
    ):
        (folder / place).mkdir(parents=True)
        (folder / place / "design.toml").write_text(text, encoding="utf-8")
    words = [*command.split(), *([] if "ws" in command else ["ws"])]
    assert main(words) == 2
    message = " ".join(capsys.readouterr().err.split())
    advice = message.partition("try: ")[2]
    if "ws/runs" in command:
        assert unnamed(message.lower(), "folder", "'ws/runs'") == []
        followed = [[*words[:-1], advice]]
    elif command == "campaign merge":
        followed = [shlex.split(advice.partition(",")[0])[1:]]
    else:
        followed = [[*words, *shlex.split(advice.partition(":")[0])]]
    for row in followed:
        if row[-2:] == ["--out", "one"]:  # whose folder stands for what this command leaves
            row[-1] = "other"
        with pytest.raises(Started):
            main(row)


def followed(message: str, words: list[str]) -> list[str]:
    """The options as the last part of a message says."""
    advice = " ".join(message.partition("try:")[2].split())
    option, value = words[0], words[-1]
    if unit := re.match(rf"{option} in (\S+?),", advice):  # the number is that of a data sheet
        return [option, ",".join(["7" + unit[1].replace("·", "")] * (value.count(",") + 1))]
    if "one pose, --pose ..." in advice and "what all joints have" not in advice:
        return [*words, "--pose", "0.1,0.1"]
    if advice == f"leave out {option}, or --pose home":
        return [*words, "--pose", "home"]
    if renamed := re.match(r"(--\S+) in the place of", advice):
        return [renamed[1], value]
    own = re.search(rf"{option} \S+", advice) or re.match(r".*?(?=; or |, or |, which|, if |: |$)", advice)
    assert own, advice
    parts = shlex.split(own[0].rstrip(",;"))
    return [parts[0], parts[1].replace("…", "7")] if parts[0].startswith("--") else [option, parts[0]]
