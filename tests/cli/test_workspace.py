"""``flexhinf design`` for a workspace, and what the other commands do with its folder."""

from __future__ import annotations

import json
import shutil
import tomllib
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from tests import workspaces
from tests.cli.conftest import QUICK, UNCERTAIN_ARM
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.cli import main
from flexhinf.designs.workspace import preset, proof as workspace_proof
from flexhinf.designs.workspace.proof import WorkspaceProof, prove_workspace
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.modal.multipliers import PopovTolerance
from flexhinf.modal.pair_errors import Errors, Sector
from flexhinf.modal.sampled_pairs import SampledPairs

# Every design compiles its loops for a few runs: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


#: Few poses and goals, one bandwidth, and a narrow range of vibrations.
FEW: dict[str, Any] = {
    "POSES": 3, "GOALS": 1, "CHOSEN_POSES": 2, "MODAL_POSES": 20, "TUNING_POSES": (4, 1), "BANDWIDTHS": (28.0,),
    "MARGIN": 1.1,
}  # fmt: skip


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    workspaces.few(monkeypatch, **FEW)


@pytest.fixture
def robot(uncertain_arm: Callable[[str], str]) -> str:
    """A robot's file, with tolerances and a limit of its motor."""
    return uncertain_arm("arm.toml")


@pytest.fixture(scope="module")
def designed(unoptimised: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a design of that robot without draws."""
    place = tmp_path_factory.mktemp("designed")
    (place / "arm.toml").write_text(UNCERTAIN_ARM)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        workspaces.few(patch, **FEW)
        main(["design", "arm.toml", "--draws", "0", "--no-advice", "--out", "made"])
    return place / "made"


@pytest.fixture
def made(designed: Path, robot: str, folder: Path) -> Path:
    """A copy of it beside the robot's file."""
    return Path(shutil.copytree(designed, folder / "made"))


def stored(folder: Path) -> tuple[dict, dict]:
    return (
        tomllib.loads((folder / "design.toml").read_text(encoding="utf-8")),
        json.loads((folder / "design.json").read_text(encoding="utf-8")),
    )


@pytest.mark.ci("designs a workspace twice")
def test_by_default_a_controller_for_the_workspace_is_written_and_made_again(
    robot: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By one process, and by two."""
    code = main(["design", robot, "--threads", "1"])
    shown = capsys.readouterr().out
    assert code == ("NOT MET" in shown)
    assert unnamed(shown, "joint ranges") == []
    first = folder / "flexhinf-design"
    assert {"index.html", "design.toml", "design.json", "controller"} <= {p.name for p in first.iterdir()}
    written, numbers = stored(first)
    own = {"workspace": "limits", "law": "modal", "estimator": "modal"}
    assert written["design"] == {"robot": "../arm.toml", **own}
    assert written["result"]["met"] == (code == 0)
    assert (numbers["law"], numbers["task"]) == (
        "modal",
        {"pose": None, "start": None, "workspace": "limits"},
    )
    assert main(["design", "flexhinf-design", "--no-advice", "--out", "again", "--threads", "2"]) == code
    again, same = stored(folder / "again")
    assert (again["design"]["workspace"], again["result"]) == ("limits", written["result"])
    assert same == numbers
    assert (folder / "again" / "controller").read_bytes() == (first / "controller").read_bytes()


@pytest.mark.ci("designs a workspace")
def test_a_loop_that_is_unstable_is_not_met_and_written(
    robot: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The ripple of an unstable pose has no number."""
    assert main(["design", robot, "--unknown-delay", "60ms", "--no-advice"]) == 1
    assert unnamed(capsys.readouterr().out, "NOT MET", "diverges", "unstable poses") == []
    written, numbers = stored(folder / "flexhinf-design")
    ripple = next(line for line in numbers["requirements"] if "ripple" in line["what"])
    assert (ripple["found"], ripple["met"], written["result"]["met"]) == (None, False, False)
    assert unnamed((folder / "flexhinf-design" / "index.html").read_text(encoding="utf-8"), "diverges") == []


@pytest.mark.ci("designs a workspace")
def test_a_file_of_waypoints_is_read_from_the_folder_of_the_design_file(robot: str, folder: Path) -> None:
    (folder / "below").mkdir()
    (folder / "below" / "way.csv").write_text("time,elbow [deg]\n0,-10\n1,20\n")
    (folder / "below" / "mine.toml").write_text(
        "[design]\nrobot = '../arm.toml'\nworkspace = 'way.csv'\ndraws = 0\n"
    )
    assert main(["design", "below/mine.toml", "--no-advice", "--payload", "0..0.05kg"]) in (0, 1)
    written, numbers = stored(folder / "flexhinf-design")
    assert written["design"]["payload"] == "0..0.05kg"
    page = (folder / "flexhinf-design" / "index.html").read_text(encoding="utf-8")
    assert "payload mass" in page
    assert written["design"]["workspace"]["elbow"] == pytest.approx([-0.174533, 0.349066], rel=1e-5)
    assert all(-0.1746 <= row["pose"][0] <= 0.3491 for row in numbers["loops"])
    assert {row["robot"] for row in numbers["runs"]} == {"nominal"}


@pytest.mark.ci("designs a workspace, and half of another one")
def test_an_interrupted_design_leaves_what_was_there(
    robot: str, made: Path, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    def stop(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(WorkspaceSetup, "move", stop)
    assert main(["design", robot, "--seed", "1", "--out", "made"]) == 130
    assert unnamed(capsys.readouterr().err, "Interrupted") == []
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["design", "--workspace", "limits", "--preset", "damped"], ("--preset", "--law nl-hinf", "--pose")),
        (["design", "--workspace", "limits", "--pose", "0.1"], ("--workspace", "--pose")),
        (["design", "--workspace=-9:9"], "'elbow'"),
        (["design", "--workspace", "here"], "'here'"),
        (["design", "--set", "gamma_ratio=1.5"], ("--set gamma_ratio", "--pose")),
        (["design", "--estimator", "observer"], ("--estimator", "--pose")),
        (["compare", "--laws", "nl-hinf"], ("'nl-hinf'", "--pose")),
        (["compare", "--pose", "0.1", "--gains", "mine.toml"], "mine.toml"),
        (["certify", "--workspace", "limits"], ("--workspace", "--pose", "flexhinf design")),
        (
            ["design", "--workspace", "limits", "--preset", "proved", "--unknown-delay", "2ms"],
            ("unknown", "2 ms"),
        ),
    ],
)
def test_what_is_of_one_pose_is_refused(
    words: list[str], what: str | tuple[str, ...], robot: str, folder: Path, refused: Callable[..., str]
) -> None:
    refused([words[0], robot, *words[1:]], what, folder)


def test_certify_proves_with_the_unknown_delay_that_an_option_or_a_file_states(
    folder: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What no proof holds is refused before any work."""
    asked = list[int]()

    def stop(request: Any, progress: object) -> None:
        asked.append(request.specification.unknown_samples)
        raise KeyboardInterrupt

    monkeypatch.setattr(import_module("flexhinf.designs"), "requested_loop", stop)
    refused(["certify", "planar-two-link", "--unknown-delay", "2ms"], ("unknown", "2 ms"), folder)
    (folder / "late.toml").write_text('[design]\nrobot = "planar-two-link"\nunknown_delay = "1ms"\n')
    for words in (["planar-two-link", "--unknown-delay", "1ms"], ["late.toml"], ["planar-two-link"]):
        assert main(["certify", *words]) == 130
    assert asked == [1, 1, 0]


@pytest.mark.ci("designs a workspace and a pose")
def test_other_commands_take_its_folder_or_say_why_not(
    made: Path,
    folder: Path,
    refused: Callable[..., str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    refused(["certify", "made", "--observer", "10"], "--observer", folder)
    (folder / "mine.toml").write_text("[pid]\nbandwidth = 12.0\n")
    capsys.readouterr()
    assert main(["compare", "made", "--laws", "pid", "--gains", "mine.toml", "--verbose"]) == 0
    assert unnamed(capsys.readouterr().out, "Criterion", "pid", "design", "unstable poses") == []
    laws = json.loads((folder / "flexhinf-compare" / "comparison.json").read_text(encoding="utf-8"))["laws"]
    assert [(law["name"], law["stated"], law["bandwidth"]) for law in laws][1:] == [("pid", True, 12.0)]
    kept = list[WorkspaceProof]()
    monkeypatch.setattr(
        workspace_proof, "prove_workspace", lambda *words: kept.append(prove_workspace(*words)) or kept[0]
    )
    assert main(["certify", "made", "--out", "proof"]) == 0
    stated = kept[0].stated._replace(errors=Errors(Sector(0.9, 0.9)))
    kept[0] = kept[0]._replace(stated=stated)
    monkeypatch.setattr(workspace_proof, "prove_workspace", lambda *words: kept[0])
    assert main(["certify", "made", "--out", "less"]) == 1  # than the file states
    proof = json.loads((folder / "proof" / "proof.json").read_text(encoding="utf-8"))
    assert 0.0 < proof["proved"]["lower"] < proof["computed"]["lower"] < abs(proof["unstable"]["error"])
    assert [text[:3] for text in proof["hypotheses"]] == ["1. ", "2. ", "3. ", "4. ", "5. ", "6. "]
    assert all("every pose" in text for text in (proof["text"], proof["hypotheses"][0]))
    assert proof["everywhere"]["low"] <= proof["stable"]["low"]
    assert proof["largest"]["tolerance"] > 0.1
    assert proof["largest"]["payload"] > 0.0
    begins = " ".join(proof["text"].split()[:7])
    assert unnamed(capsys.readouterr().out, begins, "destabilises", "--check") == []
    assert main(["certify", "--check", "proof"]) == 0
    assert unnamed(capsys.readouterr().out, "Proved", "not checked") == []
    for changed in ({"everywhere": None, "arm": {**proof["arm"], "lower": 0.9}}, {"arm": None}):
        (folder / "forged.json").write_text(json.dumps({**proof, **changed}), encoding="utf-8")
        assert main(["certify", "--check", "forged.json"]) == 1
    proof["proved"]["lower"] += 0.01
    (folder / "forged.json").write_text(json.dumps(proof), encoding="utf-8")
    assert main(["certify", "--check", "forged.json"]) == 1
    assert unnamed(capsys.readouterr().out, "Not proved", "lower") == []
    proof["pairs"]["lower"] = proof["pairs"]["upper"] = 0.99
    (folder / "forged.json").write_text(json.dumps(proof), encoding="utf-8")
    assert main(["certify", "--check", "forged.json"]) == 1
    proof["pairs"]["poles"] = "none"
    (folder / "forged.json").write_text(json.dumps(proof), encoding="utf-8")
    refused(["certify", "--check", "forged.json"], "flexhinf certify", folder)
    saved = fh.load_design(made)
    loaded, s = saved.robot, saved.specification
    refused(["campaign", "made", "--duration", "2s"], "--duration", folder)
    refused(["campaign", "made", "--tolerance", "coulomb_friction=10%"], "coulomb_friction", folder)
    campaign = ["campaign", "made", "--samples", "5", "--batch", "2", "--encoder-offset", "1e-4"]
    assert main(
        [*campaign, "--out", "whole", "--worst-case", "--metric", "remaining_error", "--starts", "1"]
    ) in (0, 1)
    assert main([*campaign, "--out", "part", "--shard", "2/2"]) == 0
    assert main([*campaign, "--out", "part"]) in (0, 1)  # goes on from there
    tables = [(folder / name / "samples.parquet").read_bytes() for name in ("whole", "part")]
    assert tables[0] == tables[1]
    capsys.readouterr()
    for which in ("--sample", "4"), ("--worst-case", "remaining_error"):
        assert main(["campaign", "replay", "whole", *which]) == 0
        assert unnamed(capsys.readouterr().out, "bits", "design") == []
    page = (folder / "whole" / "index.html").read_text(encoding="utf-8")
    assert unnamed(page, "random goals", "remaining error") == []
    assert main(["campaign", "compare", "made", "made", "--samples", "3", "--out", "pair"]) == 0
    assert unnamed(capsys.readouterr().err, "differ") == []
    assert (loaded.name, s.workspace) == ("arm", "limits")
    stated = ["--law", "nl-hinf", "--pose", "5deg", *QUICK]
    capsys.readouterr()
    assert main(["design", "made", *stated, "--estimator", "none", "--out", "one"]) in (0, 1)
    shown = capsys.readouterr()
    assert unnamed(shown.err, "workspace", "--pose") == []  # the option wins over the file
    written = stored(folder / "one")[0]
    assert "workspace" not in written["design"]
    page = (folder / "one" / "index.html").read_text(encoding="utf-8")
    for text in (shown.out, page, written["result"]["verdict"]):
        assert unnamed(text, "one pose", "--pose") == []


@pytest.mark.ci("designs a workspace, and proves it")
def test_a_law_is_chosen_that_is_proved_for_the_tolerances_of_the_file(
    robot: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first law is left, as if a grid refused it."""
    workspaces.few(monkeypatch, BANDWIDTHS=(28.0, 14.0))
    tolerance = preset.popov_tolerance

    def refused_first(pairs: SampledPairs, *words: Any) -> PopovTolerance:
        found = tolerance(pairs, *words)
        return found._replace(share=1.1 if pairs.gains.weights.bandwidth == 28.0 else found.share)

    monkeypatch.setattr(preset, "popov_tolerance", refused_first)
    words = ["--workspace", "limits", "--preset", "proved", "--draws", "0", "--no-advice"]
    assert main(["design", robot, *words, "--out", "made"]) in (0, 1)
    shown = " ".join(capsys.readouterr().out.split())
    assert unnamed(shown, " Proved ", "fastest") == []
    assert "Not proved" not in shown
    page = (folder / "made" / "index.html").read_text(encoding="utf-8")
    assert unnamed(page, "Proved", "(1)") == []
    assert stored(folder / "made")[0]["design"]["preset"] == "proved"
    proof = json.loads((folder / "made" / "proof.json").read_text(encoding="utf-8"))
    assert proof["weights"]["bandwidth"] == 14.0
    kinds = ("lower", "upper", "softer", "stiffer")
    assert all(proof["proved"][kind] >= proof["stated"][kind] for kind in kinds)
    assert proof["stated"]["softer"] == pytest.approx(0.1)
    assert main(["certify", "--check", "made"]) == 0
    design = fh.load_design(folder / "made")
    (line,) = (line for line in design.requirements if line.what.startswith("proved part"))
    assert line.met
    assert line.found >= 100.0


@pytest.mark.ci("designs a workspace")
def test_its_controller_goes_from_pose_to_pose_in_mujoco(
    made: Path, folder: Path, capsys: pytest.CaptureFixture[str], refused: Callable[..., str]
) -> None:
    pytest.importorskip("mujoco")
    run = ["run", "made", "--mujoco", "--no-realtime"]
    capsys.readouterr()
    assert main([*run, "--start", "-0.5", "--pose", "0.4", "--verbose"]) == 0
    assert unnamed(capsys.readouterr().out, "remaining error", "wrong way") == []
    (folder / "way.csv").write_text("time [s],elbow [rad]\n0,0\n1,0.2\n", encoding="utf-8")
    assert main([*run, "--move", "way.csv", "--verbose"]) == 0  # of the run alone: the controller has no move
    shown = capsys.readouterr()
    assert unnamed(shown.out, "remaining error", "wrong way") == []
    assert "gives way" not in shown.err
    for words in (["--set", "shaping=quintic"], ["--set", "feedforward=no"], ["--overshoot", "3"]):
        refused([*run, *words], words[0].removeprefix("--no-"), folder)
