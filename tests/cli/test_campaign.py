"""``flexhinf campaign``: from a judged report, again, in shards, merged, replayed; and what it refuses."""

from __future__ import annotations

import hashlib
import json
import pickle
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.builders import arm_controller, report_numbers
from tests.cli.conftest import DESIGN
from tests.designs.test_campaign_metrics import check_by_signals
from tests.refusals import refused_with, unnamed

import flexhinf as fh
import flexhinf.campaign
from flexhinf import report
from flexhinf.campaign import METHODS, Journal, MetricLimit, damping, run_batch
from flexhinf.campaign.batches import ALONE
from flexhinf.campaign.driver import in_this_process
from flexhinf.campaign.manifest import read_sealed, sealed
from flexhinf.campaign.parquet import read_columns
from flexhinf.cli import main
from flexhinf.codegen import cuda
from flexhinf.designs.campaign_folder import stored_campaign, stored_gains, stored_request
from flexhinf.designs.design_file import meant_file
from flexhinf.designs.request import read_request
from flexhinf.errors import InvalidInput
from flexhinf.pages.campaign_text import in_degrees, limit_text, percent_text, value_text

pytest.importorskip("pyarrow")

# Some twenty loops of 40 short runs: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

WORDS = ["campaign", "design/design.toml", "--samples", "40", "--batch", "16", "--out", "runs"]


@pytest.fixture
def judged(folder: Path) -> Path:
    """The report of a design, as far as a campaign needs it: nothing is designed."""
    controller = arm_controller(kind=fh.ExtendedKalmanFilter, q=1e-8, r=1e-8, p0=1e-6, start="bumpless")
    controller.save(folder / "law")
    files = {"design.toml": DESIGN, "design.json": report_numbers()}
    report.write(folder / "design", {**files, "controller": (folder / "law").read_bytes()})
    (folder / "law").unlink()
    return folder


def said(capsys: pytest.CaptureFixture[str]) -> str:
    return "".join(capsys.readouterr())


def test_a_page_has_the_angles_of_the_page_of_its_design() -> None:
    settings, units = {"design angle_unit": "deg"}, {"link_position": "rad"}
    table = SimpleNamespace(
        journal=SimpleNamespace(settings=settings), unit=units.get, names=lambda kind: tuple(units)
    )
    judged: Any = SimpleNamespace(table=table)
    assert in_degrees(judged)
    units["slide_position"] = "m"  # no page of a design with a joint that slides has degrees
    assert not in_degrees(judged)
    del units["slide_position"]
    settings.clear()
    assert not in_degrees(judged)
    shown = [value_text(0.01, unit, degrees) for degrees in (True, False) for unit in ("rad", "rad/s", "V")]
    assert shown == ["0.573°", "0.573 °/s", "0.01 V", "10 mrad", "0.01 rad/s", "0.01 V"]
    assert limit_text(MetricLimit("final_error", 0.01), "rad", degrees=True) == f"at most {shown[0]}"


@pytest.mark.ci("a campaign, again after damage, and two replays")
def test_run_again_and_replay(judged: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(WORDS) in (0, 1)
    text = said(capsys)
    assert "of 40 failed" in text
    assert "worst overshoot" in text
    table = (judged / "runs" / "samples.parquet").read_bytes()
    page = (judged / "runs" / "index.html").read_text()
    for title in ("Success", "Signals", "Metrics", "What matters", "Failures", "flexhinf campaign"):
        assert title in page
    assert "src=" not in page
    shards = sorted((judged / "runs" / "shards").iterdir())
    shards[1].write_bytes(shards[1].read_bytes()[:-7])
    assert main(WORDS) in (0, 1)
    assert "damaged" in said(capsys)
    assert (judged / "runs" / "samples.parquet").read_bytes() == table
    assert main(["campaign", "replay", "runs", "--sample", "23", "--out", "run.nc"]) == 0
    assert unnamed(said(capsys), "sample 23", "completed", "same", "The design") == []
    (worst,) = re.findall(r"\(sample (\d+)\)", text)
    (line,) = re.findall(r"^replay: flexhinf (.*)$", text, re.MULTILINE)
    assert main(shlex.split(line)) == 0
    assert unnamed(said(capsys), f"sample {worst}", "completed", "same") == []
    assert (judged / "run.nc").stat().st_size > 10_000


@pytest.mark.ci("a campaign of 2 s, its page and a replay")
def test_robots_that_oscillate_without_end_are_told(judged: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Soft springs: the loop is unstable, and the limit of the input keeps its numbers finite."""
    soft = ["--tolerance", "stiffness=1..100", "--duration", "2"]
    assert main([*WORDS, *soft, "--require", "overshoot_percent<=1e9"]) == 1
    text = " ".join(said(capsys).split())
    (failed, unstable, moving, diverged) = map(
        int,
        re.findall(
            r"(\d+) of 40 failed, (\d+) .*unstable \((\d+) .*, (\d+) diverged",
            text,
        )[0],
    )
    assert failed == unstable == moving > 5
    assert diverged == 0
    page = (judged / "runs" / "index.html").read_text()
    assert unnamed(page, "stable", "unstable", "not met") == []
    table = read_columns(judged / "runs" / "samples.parquet", ["status"]).column("status").to_pylist()
    assert table.count("unstable") == unstable
    assert main(["campaign", "replay", "runs", "--sample", str(table.index("unstable"))]) == 0
    assert "same bits" in said(capsys)


@pytest.mark.ci("a campaign with its page")
@pytest.mark.parametrize("method", METHODS)
def test_only_independent_samples_have_an_interval(
    judged: Path, capsys: pytest.CaptureFixture[str], method: str
) -> None:
    """Terminal and page say the same: one interval, or why there is none."""
    assert main([*WORDS, "--method", method]) in (0, 1)
    text, page = said(capsys), (judged / "runs" / "index.html").read_text()
    assert ("with 95 % confidence" in text) == (method == "random")
    assert ("Clopper" in page) == ("95\N{NO-BREAK SPACE}%: " in page) == (method == "random")
    for place in (text, page):
        assert ("no confidence" in place) == (method != "random")


@pytest.mark.ci("two campaigns with their pages")
def test_folders_that_somebody_changed_are_refused_in_words(
    judged: Path, refused: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Every command that reads a journal: resume, merge into it and out of it, replay."""
    assert main(WORDS) in (0, 1)
    runs, shards = judged / "runs", judged / "runs" / "shards"
    content = (runs / "campaign.json").read_bytes()
    stated = read_sealed(runs / "campaign.json")
    changed = ({"about": 3}, {"version": 99}, {"settings": stated["settings"] | {"samples": 1e14}})
    commands = WORDS, ["campaign", "merge", "runs"], ["campaign", "replay", "runs", "--sample", "1"]
    for changes, words in zip(changed, commands):
        (runs / "campaign.json").write_bytes(sealed(stated | changes))
        refused(words, ("manifest", "campaign.json"), judged)
    options = stated["about"]["options"]
    for changes in ({"samples": "many"}, {"tolerances": 3}, {"tolerances": [[1]]}, {"method": 7}):
        about = stated["about"] | {"options": options | changes}
        (runs / "campaign.json").write_bytes(sealed(stated | {"about": about}))
        refused(["campaign", "replay", "runs", "--sample", "1"], "", judged)
    (runs / "campaign.json").write_bytes(content)
    parts = sorted(shards.iterdir())
    wrong = parts[0].read_bytes()
    parts[1].unlink()
    digest = hashlib.sha256(wrong).hexdigest()[:16]
    (misplaced := shards / f"batch-00000001-{digest}.parquet").write_bytes(wrong)
    assert "missing: 1" in refused(["campaign", "merge", "runs"], ("complete", "2;"), judged)
    assert main(["campaign", "replay", "runs", "--sample", "20"]) == 0
    assert unnamed(said(capsys), "sample 20", "table") == []
    assert main(WORDS) in (0, 1)
    aside = misplaced.with_name(f"{misplaced.name}.aside")
    assert set(shards.iterdir()) == {*parts, aside}
    assert aside.read_bytes() == wrong


def test_a_campaign_that_is_not_complete_never_exits_with_0(
    judged: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def losing(workers: int, note: object, device: str) -> object:
        return lambda campaign, batches: in_this_process(campaign, batches[1:])

    monkeypatch.setattr(flexhinf.campaign, "in_processes", losing)
    for more in ([], ["--shard", "1/2"]):
        assert main([*WORDS, "--workers", "1", *more]) == 2
        assert "not run" in said(capsys)
    assert not (judged / "runs" / "samples.parquet").exists()


def test_fractions_are_told_from_none_and_all() -> None:
    assert [percent_text(f) for f in (0.0, 3.7e-4, 0.3, 0.99963, 1.0)] == [
        "0 %", "0.037 %", "30.0 %", "99.9630 %", "100 %",
    ]  # fmt: skip


@pytest.mark.ci("a campaign, and its signals by Python")
def test_lanes_say_what_the_signals_of_each_run_say(judged: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert main([*WORDS, "--initial-error", "0.01"]) in (0, 1)
    campaign, journal = stored_campaign(judged / "runs")
    assert ALONE not in campaign.modes([campaign.sample(0)])
    travelled = pickle.loads(pickle.dumps(campaign))
    monkeypatch.setenv("FLEXHINF_LANES_FROM", "0")
    lanes = run_batch(travelled, 1)
    monkeypatch.undo()
    check_by_signals(stored_request(journal), campaign, lanes)
    row, first = journal.row(int(lanes["sample"][0])), {name: values[0] for name, values in lanes.items()}
    metrics = [column.name for column in campaign.columns if column.kind == "metric"]
    assert {name: first[name] for name in metrics} == {name: row[name] for name in metrics}


@pytest.mark.ci("the same campaign whole and in shards")
def test_shards_of_jobs_are_merged_to_the_same_table(
    judged: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(WORDS) in (0, 1)
    whole = (judged / "runs" / "samples.parquet").read_bytes()
    for out, shard in (("a", "1/3"), ("b", "2/3"), ("a", "3/3")):
        assert main([*WORDS[:-1], out, "--shard", shard]) == 0
        assert "flexhinf campaign merge" in said(capsys)
    assert main(["campaign", "merge", "a"]) == 2
    assert "missing: 1" in said(capsys)
    assert main(["campaign", "merge", "a", "b"]) in (0, 1)
    assert (judged / "a" / "samples.parquet").read_bytes() == whole


@pytest.mark.ci("a campaign and two pages")
def test_requirements_decide_the_exit_code(judged: Path, capsys: pytest.CaptureFixture[str]) -> None:
    easy, hard = ["--require", "peak_speed<=1e6"], ["--require", "peak_speed<=0"]
    assert main([*WORDS, *easy]) == 0
    assert "0 of 40 failed" in said(capsys)
    assert main(["campaign", "merge", "runs", *hard]) == 1
    assert "40 of 40 failed" in said(capsys)
    page = (judged / "runs" / "index.html").read_text()
    assert "flexhinf campaign replay runs --sample" in page


@pytest.mark.ci("searches the worst robot by two metrics")
def test_the_worst_robot_is_searched_kept_and_replayed(
    judged: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    metrics = ["--metric", "peak_speed", "--metric", "settling_time_s", "--metric", "damping"]
    search = ["--worst-case", *metrics, "--starts", "2"]
    assert main([*WORDS, *search]) in (0, 1)
    text = said(capsys)
    assert unnamed(text, "worst", "peak speed") == []
    assert f"flexhinf campaign replay {judged / 'runs'} --worst-case " in text
    page = (judged / "runs" / "index.html").read_text()
    for words in ("Worst case", "worst corner", "worst found", "replay runs --worst-case", "lower bound"):
        assert words in page
    kept = (judged / "runs" / "worst-case" / "peak_speed.json").read_bytes()
    value = json.loads(kept)["found"]["value"]
    limit = ["--require", f"peak_speed<={0.5 * (value + json.loads(kept)['sampled']['value'])!r}"]
    assert main(["campaign", "merge", "runs", *limit]) == 1  # every sample keeps it, the robot found does not
    assert "0 of 40 failed" in said(capsys)
    page = re.sub(r"<figure.*?</figure>", "", (judged / "runs" / "index.html").read_text(), flags=re.DOTALL)
    status = page.split('class="verdict"')[1][:5000]
    assert unnamed(status, "not met", "peak speed") == []
    assert main([*WORDS, *search]) in (0, 1)
    assert (judged / "runs" / "worst-case" / "peak_speed.json").read_bytes() == kept
    assert main(["campaign", "replay", "runs", "--worst-case", "peak_speed", "--out", "run.nc"]) == 0
    assert unnamed(said(capsys), "peak speed", "completed", "same") == []
    assert main(["campaign", "replay", "runs", "--worst-case", "damping"]) == 0
    assert unnamed(said(capsys), "worst damping", "same") == []
    assert (judged / "run.nc").stat().st_size > 10_000


PROVED = """
[design]
robot = "paper"
penalty = {link_position=75, link_velocity=27, motor_position=90, motor_velocity=27, link_position_integral=330}
pose = "180deg"
start = "0"
degrees = [4]
draws = 0
duration = 2.0
"""


@pytest.mark.nightly(
    "the worst disturbance by the command; tests/analysis has its search, the test above its page"
)
def test_the_worst_disturbance_stays_below_the_proved_gamma(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "own.toml").write_text(PROVED)
    search = ["campaign", "own.toml", "--samples", "4", "--out", "runs", "--worst-case", "--metric", "gain"]
    assert main(search) in (0, 1)
    text = said(capsys)
    assert unnamed(text, "nominal robot", "synthesis", "proved γ²") == []
    path, journal = folder / "runs" / "worst-case" / "disturbance.json", Journal.read(folder / "runs")
    assert journal is not None
    rows, kept = stored_gains(journal).rows, path.read_bytes()
    assert [(row.robot, row.loop, row.pair) for row in rows] == [
        ("nominal", "true state", "synthesis"), ("worst", "true state", "synthesis"),
        ("nominal", "estimator", "synthesis"), ("nominal", "true state", "proof"),
    ]  # fmt: skip
    nominal, worst, _, proved = rows
    assert worst.gain >= nominal.gain
    assert nominal.kept
    assert proved.claim == "proved"
    assert 0.3 * proved.gamma < proved.gain <= proved.gamma
    assert main(["campaign", "replay", "runs", "--worst-case", "gain"]) == 0
    assert unnamed(said(capsys), "disturbances", "same") == []
    path.write_bytes(kept[:-5])
    with refused_with(InvalidInput, "disturbance.json", "searches again"):
        stored_gains(journal)
    assert main(search) in (0, 1)
    assert path.read_bytes() == kept
    assert "Worst disturbance" in (folder / "runs" / "index.html").read_text()


@pytest.mark.ci("a campaign with its page")
def test_mistakes_of_the_worst_case(
    judged: Path,
    refused: Callable[..., str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    refused(
        [*WORDS, "--worst-case", "--metric", "overshot"], ("metric 'overshot'", "'overshoot_percent'"), judged
    )
    refused([*WORDS, "--metric", "peak_speed"], "--worst-case", judged)
    refused([*WORDS, "--worst-case", "--starts", "0"], "starts", judged)
    assert not (judged / "runs").exists()
    with monkeypatch.context() as patch:
        patch.setattr(damping, "ECHO", 2.0)  # as if the input's delay were long
        assert main([*WORDS, "--worst-case", "--metric", "damping"]) == 2
    assert "delay" in capsys.readouterr().err
    assert list((judged / "runs" / "shards").iterdir()) == []  # it is said before the runs
    assert main(WORDS) in (0, 1)
    refused(["campaign", "replay", "runs"], "--sample or --worst-case", judged)
    refused(["campaign", "replay", "runs", "--sample", "1", "--worst-case", "peak_speed"], "both", judged)
    refused(
        ["campaign", "replay", "runs", "--worst-case", "peak_speed"],
        ("worst", "searched", "peak_speed"),
        judged,
    )
    refused(["campaign", "replay", "runs", "--worst-case", "../x"], ("metric", "../x"), judged)
    refused(["campaign", "replay", "runs", "--worst-case", "gain"], ("disturbance.json", "searched"), judged)


def test_what_differs_from_sample_to_sample(judged: Path) -> None:
    more = ["--tolerance", "stiffness=20%", "--tolerance", "mass=0.9..1.3", "--initial-error", "0.01"]
    words = [
        *WORDS[:-1],
        "more",
        "--samples",
        "4",
        *more,
        "--disturbance",
        "0.2",
        "--method",
        "sobol",
        "--distribution",
        "normal",
    ]
    assert main([word if word != "normal" else "truncated-normal" for word in words]) in (0, 1)
    settings = json.loads((judged / "more" / "campaign.json").read_text())["settings"]
    assert settings["variable stiffness"] == "truncated-normal in [80.0, 120.0] N·m/rad"
    assert settings["variable mass"] == "truncated-normal in [0.9, 1.3] kg"
    assert settings["variable initial_error"] == "truncated-normal in [-0.01, 0.01] rad"
    assert settings["variable link_torque"] == "truncated-normal in [-0.2, 0.2] N·m"
    assert "variable inductance" not in settings  # it does not act without the extra


def test_without_a_gpu_nothing_is_begun(
    judged: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cuda, "card", lambda: cuda.Card(cuda.Driver("libnothing.so.7")))
    for more in ([], ["--workers", "2"]):
        refused([*WORDS, "--device", "gpu", *more], ("driver", "libnothing.so.7", "--device cpu"), judged)
    assert not (judged / "runs").exists()


@pytest.mark.parametrize(
    ("more", "what"),
    [
        (["--samples", "0"], "samples"),
        (["--samples", "-5"], "samples"),
        (["--require", "overshot<=5"], ("metric 'overshot'", "'overshoot_percent'")),
        (["--require", "overshoot_percent"], ("requirement", "'overshoot_percent'")),
        (["--tolerance", "stifness=5%"], ("'paper'", "parameter 'stifness'")),
        (["--tolerance", "stiffness"], ("tolerance", "NAME=x", "'stiffness'")),
        (["--tolerance", "stiffness=five"], ("tolerance", "'stiffness'", "'five'")),
        (["--tolerance", "inductance=5%"], ("parameter 'inductance'", "extras")),
        (["--distribution", "gauss"], ("distribution", "'truncated-normal'", "'gauss'")),
        (["--method", "halton"], ("method", "'latin-hypercube'", "'halton'")),
        (["--shard", "4/3"], ("shard", "1/n to n/n", "4/3")),
        (["--shard", "third"], ("shard", "i/n", "'third'")),
        (["--workers", "-1"], "workers"),
        (["--cluster", "localhost"], ("tcp://HOST:PORT", "'localhost'")),
        (["--cluster", "tcp://a:1", "--workers", "2"], "--workers and --cluster"),
        (["--initial-error", "-1"], ("--initial-error", "'-1'")),
        (["--duration", "-1"], "duration"),
        (["--out", "design"], ("campaign.json", "'design.toml'")),
        (["--payload", "much"], "payload"),
        (["--device", "tpu"], ("--device", "'tpu'", "gpu")),
    ],
)
def test_mistakes_are_told_before_any_work(
    judged: Path, refused: Callable[..., str], more: list[str], what: str | tuple[str, ...]
) -> None:
    refused([*WORDS, *more], what, judged)


@pytest.mark.ci("runs campaigns")
def test_another_campaign_in_the_folder_is_refused(judged: Path, refused: Callable[..., str]) -> None:
    assert main(WORDS) in (0, 1)
    message = refused([*WORDS, "--samples", "41", "--tolerance", "mass=7%"], ("another", "settings"), judged)
    assert "samples: 40 → 41" in message
    assert re.search(r"variable mass: .*\[0\.95, 1\.05\] kg → .*\[0\.9[23]\d*, 1\.07\d*\] kg", message)
    (judged / "design" / "design.toml").write_text(DESIGN.replace("30.0", "31.0"))
    message = refused(WORDS, ("another", "settings"), judged)
    assert "design overshoot: 30.0 → 31.0" in message
    refused(["campaign", "replay", "runs", "--sample", "40"], "sample", judged)
    refused(["campaign", "replay", "design", "--sample", "4"], ("campaign.json", "design"), judged)
    refused(["campaign", "merge", "nowhere"], ("campaign", "nowhere"), judged)


def test_a_robot_without_tolerances(folder: Path, arm: str, refused: Callable[..., str]) -> None:
    (folder / "arm.toml").write_text(arm)
    (folder / "one.toml").write_text('[design]\nrobot = "arm.toml"\npose = [0.1]\n')
    refused(["campaign", "one.toml", "--samples", "4"], ("'arm'", "tolerance", "--initial-error"), folder)
    refused(["campaign", "one.toml", "--encoder-offset", "1e-3"], ("--encoder-offset", "--pose"), folder)


@pytest.mark.ci("two campaigns with their pages")
def test_the_folder_of_a_report_is_taken_as_its_design_file(
    judged: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["campaign", "design", "--samples", "4", "--duration", "0.1", "--out", "runs"]) in (0, 1)
    assert main(
        ["campaign", "design/design.toml", "--samples", "4", "--duration", "0.1", "--out", "runs"]
    ) in (0, 1)
    laws = [fh.load_controller(judged / path).law for path in ("runs/setup/controller", "design/controller")]
    assert laws[0].law_data.tolist() == laws[1].law_data.tolist()
    (judged / "design").rename(judged / "paper")
    assert meant_file("paper") == "paper"  # a robot of the catalogue
    assert Path(meant_file("./paper")) == Path("paper/design.toml")
    assert read_request(meant_file("./paper")).file == Path("paper/design.toml")
    assert read_request("paper").file is None


@pytest.mark.ci("designs a robot, and starts two workers")
def test_without_a_report_it_is_designed_first(folder: Path, arm: str) -> None:
    (folder / "arm.toml").write_text(arm)
    (folder / "design.toml").write_text(
        '[design]\nrobot = "arm.toml"\npose = "home"\ndegrees = [2]\nrays = 0\ndraws = 0\nduration = 1.0\n'
    )
    words = ["campaign", "design.toml", "--samples", "30", "--tolerance", "stiffness=10%", "--out", "runs"]
    assert main(words) in (0, 1)
    assert main([*words, "--workers", "2"]) in (0, 1)
