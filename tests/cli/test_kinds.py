"""Commands × designs: each command works for every law and task, or refuses it by name with advice that works."""

from __future__ import annotations

import re
import shlex
import shutil
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests import workspaces
from tests.refusals import unnamed
from tests.tiers import ci_and_night

from flexhinf.cli import main

#: Options of each design; the ends of motors' limits are those of `export`, which takes none without them.
DESIGNS: dict[str, list[str]] = {
    "modal over a workspace": ["--workspace", "0:0.1"],
    "modal at a pose": ["--law", "modal", "--pose", "home"],
    "nl-hinf at a pose": ["--pose", "home", "--degrees", "2", "--set", "rays=0"],
    "lqg at a pose": ["--law", "lqg", "--pose", "home"],
    "pd at a pose": ["--law", "pd", "--pose", "home"],
    "lqg over a workspace": ["--law", "lqg", "--workspace", "0:0.1"],
    "pd over a workspace": ["--law", "pd", "--workspace", "0:0.1"],
}

#: Few poses, moves and bandwidths; a narrow range of vibrations, of which less is to be proved.
FEW: dict[str, Any] = {
    "POSES": 2, "GOALS": 1, "CHOSEN_POSES": 2, "MODAL_POSES": 20, "TUNING_POSES": (2, 1), "TUNING_MOVES": 1,
    "BANDWIDTHS": (10.0,), "MARGIN": 1.001,
}  # fmt: skip

#: What refuses some designs: commands, designs, and what the refusal names beside the law.
NO_CONTROLLER = "solved anew at each pose"
NO_PAIRS = "functions of M(q) alone"
NO_MARGIN = "no margin at the operating point"
REFUSALS = {
    **{(command, "lqg over a workspace"): ("lqg", NO_CONTROLLER) for command in ("run", "c", "web")},
    **{
        ("certify", f"{law} {task}"): (law, NO_PAIRS)
        for law in ("lqg", "pd")
        for task in ("at a pose", "over a workspace")
    },
    ("certify", "nl-hinf at a pose"): (NO_MARGIN,),
}


def words_of(command: str, folder: str, out: str) -> list[str]:
    """The command about a design's folder, with little work."""
    own = {
        "again": ["design", folder, "--no-advice"],
        "campaign": ["campaign", "run", folder, "--samples", "4"],
        "run": ["run", folder, "--mujoco", "--no-realtime", "--duration", "0.5s"],
        "c": ["export", "c", folder, "--accept-unmet"],
        "web": ["export", "web", folder],
        "certify": ["certify", folder],
    }
    return [*own[command], "--out", out]


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """One folder for all designs, made with few poses and moves."""
    folder = tmp_path_factory.mktemp("kinds")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        workspaces.few(patch, **FEW)
        yield folder


@pytest.fixture(scope="module")
def designed(rooms: Path) -> Callable[[str], str]:
    """``designed(name)``: the folder of a design, made once."""

    def made(name: str) -> str:
        folder = name.replace(" ", "-")
        if not (rooms / folder).exists():
            common = ["--draws", "0", "--saturation", "48", "--no-advice", "--out", folder]
            assert main(["design", "paper", *DESIGNS[name], *common]) in (0, 1)
        return folder

    return made


def request_and_result(folder: str) -> tuple[Any, Any]:
    """What design.toml asks for, and what came of it."""
    document = tomllib.loads((Path(folder) / "design.toml").read_text(encoding="utf-8"))
    return document["design"], document["result"]


@pytest.mark.parametrize("name", DESIGNS)
@pytest.mark.ci("a design of each law and task")
def test_a_design_names_its_law_and_has_a_page(
    designed: Callable[[str], str], name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = designed(name)
    law, estimator = name.split()[0], "ukf" if name.startswith("nl-hinf") else "modal"
    said = f"One controller (law {law}, estimator {estimator}) for"
    assert unnamed(" ".join(capsys.readouterr().out.split()), said) == []
    assert said in (Path(folder) / "index.html").read_text(encoding="utf-8")
    asked, _ = request_and_result(folder)
    assert (asked["law"], asked["estimator"]) == (law, estimator)


#: Those whose reading costs more; tests/cli/test_design_again.py reads one of them back in `make ci`.
SLOW = ("nl-hinf at a pose", "lqg over a workspace", "pd over a workspace")


@pytest.mark.parametrize(
    "name", ci_and_night("a design of each law, again", [name for name in DESIGNS if name not in SLOW], SLOW)
)
def test_a_folder_reads_back_as_the_same_design(designed: Callable[[str], str], name: str) -> None:
    folder = designed(name)
    again = f"{folder}-again"
    assert main(words_of("again", folder, again)) in (0, 1)
    assert request_and_result(again) == request_and_result(folder)


@pytest.mark.parametrize("name", DESIGNS)
@pytest.mark.ci("a comparison for each law and task")
def test_each_design_is_compared(designed: Callable[[str], str], name: str) -> None:
    words = ["compare", designed(name), "--laws", "pd", "--out", "compared"]
    assert main(words) == 0
    assert "pd" in Path("compared/index.html").read_text(encoding="utf-8")


#: Commands and designs; what a second task of a law costs more, and proofs of the modal law, of which one at a pose is
#: what a refusal advises, see below.
ALL = [(command, name) for command in ("campaign", "run", "c", "web", "certify") for name in DESIGNS]
LONG = [
    ("certify", "modal over a workspace"), ("certify", "modal at a pose"),
    ("c", "pd over a workspace"), ("web", "pd over a workspace"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("command", "name"),
    ci_and_night("each command for each law", [case for case in ALL if case not in LONG], LONG),
)
def test_each_command_works_or_refuses_by_name(
    designed: Callable[[str], str], command: str, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, refusal = designed(name), REFUSALS.get((command, name))
    if command == "run":
        pytest.importorskip("mujoco")
    if command == "web" and not (shutil.which("clang") and shutil.which("wasm-ld")):
        pytest.skip("missing: clang or wasm-ld")
    capsys.readouterr()
    code = main(words_of(command, folder, f"{folder}-{command}"))
    told = capsys.readouterr().err
    if refusal is None:
        assert not re.search("^error:", told, re.MULTILINE)
        assert code in (0, 1)
        made = Path(f"{folder}-{command}")  # the page of `export web` is one file
        assert made.is_file() or any((made / page).exists() for page in ("index.html", "Makefile"))
    else:
        assert code == 2
        assert unnamed(" ".join(told.split()), *refusal) == []
        assert not Path(f"{folder}-{command}").exists()


def test_five_refusals_at_most() -> None:
    assert len(set(REFUSALS.values())) <= 5


@pytest.mark.parametrize(
    ("command", "name", "follow"),
    ci_and_night(
        "designs and a proof",
        [
            ("c", "lqg over a workspace", ["--pose home"]),
            ("certify", "lqg at a pose", ["--law modal"]),
        ],
        [
            ("c", "lqg over a workspace", ["--law modal"]),
            ("certify", "lqg over a workspace", ["--law modal", "--law nl-hinf"]),
            ("certify", "nl-hinf at a pose", ["--preset damped"]),
        ],
    ),
)
def test_what_a_refusal_advises_works(
    designed: Callable[[str], str],
    command: str,
    name: str,
    follow: list[str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Ways of the advice by how they begin; where another design is advised, that design and then the command."""
    folder = designed(name)
    capsys.readouterr()
    assert main(words_of(command, folder, "refused")) == 2
    advice = " ".join(capsys.readouterr().err.split()).partition("try: ")[2]
    ways = [
        shlex.split(" ".join(re.findall(r"--(?!out)[\w-]+ [^\s,;]+", way)))
        for way in re.split(r"; or |, or ", advice)
    ]
    for begins in follow:
        (options,) = (way for way in ways if " ".join(way).startswith(begins))
        made = f"{folder}-{command}-{begins.split()[-1]}"
        if "another design" in advice:
            assert main(["design", folder, *options, "--no-advice", "--out", made]) in (0, 1)
            assert main(words_of(command, made, f"{made}-{command}")) == 0
        else:
            assert main([*words_of(command, folder, made), *options]) in (0, 1)
            assert (Path(made) / "index.html").exists()
