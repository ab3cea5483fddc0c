"""Every option of every command is read by what the command computes with; what would be ignored is refused."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.builders import arm_controller
from tests.refusals import unnamed
from typer.main import get_command

import flexhinf as fh
from flexhinf import pages, report
from flexhinf.cli import arguments, main
from flexhinf.cli.arguments import with_options, without_effect, without_effect_on_run
from flexhinf.cli.check_log import check_log
from flexhinf.cli.commands import app
from flexhinf.cli.logs import read_stated
from flexhinf.cli.options import CERTIFY_FIELDS, RUN_FIELDS, CompareOptions
from flexhinf.designs.campaign_options import CampaignOptions
from flexhinf.designs.laws import LAWS
from flexhinf.designs.specification import FIELDS, Specification
from flexhinf.designs.synthesis import by_step
from flexhinf.errors import InvalidInput
from flexhinf.options import declared, option_name
from flexhinf.paper import PaperSettings
from flexhinf.processors import thread_count

# What is computed here is computed once: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

#: Files that read every field to write it, to copy it or to check it, and compute nothing.
WRITERS = ("dataclasses.py", "options.py", "design_file.py", "stated_units.py", "arguments.py")

#: Functions that refuse a field whatever it is.
REFUSERS = ("refuse_workspace",)

#: Properties of a specification that stand for a field.
BEHIND = {
    "known_latency": "latency",
    "unknown_samples": "unknown_delay",
    "damped_below_limit": "damped_below",
    "in_degrees": "angle_unit",
}


def commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*path, name))
        elif hasattr(inspect.unwrap(command.callback), "options"):
            yield (*path, name), command


COMMANDS = dict(commands(get_command(app)))


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Fields of specifications that are read by what computes, from now on."""
    found: set[str] = set()

    def recorded(s: Specification, name: str) -> Any:
        code = sys._getframe(1).f_code
        computes = (
            Path(code.co_filename).name not in (*WRITERS, "specification.py") and code.co_name not in REFUSERS
        )
        if name in BEHIND or (name in FIELDS and computes):
            found.add(BEHIND.get(name, name))
        return object.__getattribute__(s, name)

    monkeypatch.setattr(Specification, "__getattribute__", recorded)
    return found


def test_a_field_that_is_only_copied_is_not_recorded(read: set[str]) -> None:
    """The recording can fail."""
    from dataclasses import replace

    replace(Specification(draws=3), rays=5)
    assert read == set()
    assert Specification(draws=3).draws == 3
    assert read == {"draws"}


SMALL: dict[str, Any] = {"degrees": "2", "rays": 5, "draws": 0, "estimator": "ekf"}
#: With which the search for a proof has one law to try.
STATED = {"bandwidth": "4", "damping": "0.3", "gamma_ratio": "2"}


#: Set to 0 on the way to a certificate or a comparison, which have no sampled region.
REPLACED = {"rays"}


def certified(robot: str = "paper", **fields: Any) -> None:
    """The certificates of all degrees, and the pictures of the first."""
    from flexhinf.designs.certification import certify_design, evidence, proved

    s, progress = Specification(**fields), lambda *_: None
    results = certify_design(fh.load_robot(robot), s, progress, progress)
    if results[0].certificate is not None:
        evidence(fh.load_robot(robot), s, proved(results, results[0].choice.degree))


@pytest.mark.ci("certificates of two degrees")
def test_certify_takes_what_it_reads(read: set[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """With weights that are stated, and a step that chooses the degree; --set proof_seconds is of the preset proved."""
    monkeypatch.setattr(by_step, "ACTING", 0.0)
    monkeypatch.setattr(by_step, "GAIN", -1e9)  # a higher degree is judged whatever it costs
    certified(pose="20deg", degrees="2,4", preset="paper", estimator="ekf")
    assert read - set(CERTIFY_FIELDS) <= REPLACED
    of_moves = {"damped_below", "feedforward"}  # and of shaped commands
    chooses = {"law"}  # whose proof it is
    assert set(CERTIFY_FIELDS) - read == {"proof_seconds"} | of_moves | chooses


@pytest.mark.parametrize(
    ("preset", "stated"),
    [
        pytest.param("damped", {}, marks=pytest.mark.ci("searches weights for a certificate")),
        pytest.param("proved", STATED, marks=pytest.mark.ci("searches the step of a law")),
        pytest.param("robust", {}, marks=pytest.mark.nightly("searches as damped, over the tolerances")),
    ],
)
def test_certify_takes_what_it_reads_with_a_search(
    read: set[str], preset: str, stated: dict[str, str]
) -> None:
    certified(pose="20deg", degrees="2", preset=preset, **stated)
    assert read - set(CERTIFY_FIELDS) <= REPLACED
    assert ("proof_seconds" in read) == (preset == "proved")


@pytest.mark.ci("a whole design")
def test_a_design_is_made_with_every_field(read: set[str], tmp_path: Path) -> None:
    way = tmp_path / "way.csv"
    way.write_text("time,link [deg]\n0,0\n2,20\n")
    s = Specification(pose="20deg", move=str(way), shaping="quintic", preset="damped", start="0", **SMALL)
    fh.design(fh.load_robot("vertical-rig"), s).save(tmp_path / "report")
    assert set(FIELDS) == read


@pytest.mark.ci("two runs with their tables")
def test_run_takes_what_it_reads(read: set[str], tmp_path: Path) -> None:
    """What it reads beside is of the controller: its sensors and limits, which no option of a run changes."""
    pytest.importorskip("mujoco")
    from flexhinf.designs.deployed_run import prepare_run

    robot = fh.load_robot("paper")
    controller = arm_controller(at=[-0.1], q=1e-9, r=1e-8, p0=1e-6, start="bumpless")
    way = {"time": (0.0, 0.05), "joint": (0.0, 0.02)}
    for fields in ({"start": (-0.1,), "duration": 0.02}, {"move": way, "duration": 0.02}):
        s = Specification(pose=(0.0,), **fields)  # type: ignore[arg-type]
        prepared = prepare_run(controller, (robot, s), robot, s)
        made = fh.run_realtime(prepared.loop, **prepared.arguments, real_time=False)
        pages.run_tables(prepared, made)
        prepared.requirements(made)
    assert set(RUN_FIELDS) - {"load"} - read == set()  # --load is an option of the run's own
    of_controller = {
        "bandwidth", "estimator", "friction_model", "law", "measured", "period", "peak_effort", "peak_speed",
        "saturation",
    }  # fmt: skip
    assert read - set(RUN_FIELDS) <= of_controller


@pytest.mark.parametrize(
    ("command", "robot", "fields", "idle"),
    [
        ("design", "paper", {"tracking_error": 0.1}, {"tracking_error"}),
        ("compare", "paper", {"tracking_error": 0.1}, {"tracking_error"}),
        ("design", "paper", {"command": True}, {"command"}),
        ("design", "paper", {"command": True, "disturbances": ["link_torque"]}, set()),
        ("design", "paper", {"estimator": "none", "process_noise": 1e-9}, {"process_noise", "measurement_noise"}),
        ("design", "paper", {"estimator": "none", "seed": 5}, {"measured"}),
        ("design", "paper", {"estimator": "none", "seed": 5, "draws": 0}, {"measured"}),
        ("design", "paper", {"estimator": "none", "seed": 5, "rays": 0}, {"measured", "proof_seconds"}),
        (
            "design", "paper", {"estimator": "none", "seed": 5, "rays": 0, "draws": 0},
            {"measured", "proof_seconds", "seed"},
        ),
        ("design", "paper", {"seed": 5, "rays": 0, "draws": 0}, {"proof_seconds"}),
        ("compare", "paper", {"estimator": "none", "seed": 5}, {"measured"}),
        ("compare", "paper", {"estimator": "none", "draws": 0, "rays": 0}, {"measured", "proof_seconds", "seed"}),
        ("certify", "paper", {"degrees": 2, "seed": 5}, {"proof_seconds", "seed"}),
        ("certify", "paper", {"seed": 5}, {"proof_seconds"}),
        ("design", "paper", {"friction_model": True}, {"friction_model"}),
        ("design", "paper", {"friction_model": True, "extras": ["coulomb_friction"]}, set()),
        ("design", "planar-two-link", {"friction_model": True}, {"proof_seconds"}),
        ("design", "paper", {"rays": 0, "checked_penalty": [1.0]}, {"checked_penalty", "proof_seconds"}),
        ("design", "paper", {"rays": 0, "proof_seconds": 0}, set()),
        ("design", "paper", {"via": [(0.1,)]}, {"proof_seconds"}),
        ("design", "planar-two-link", {}, {"proof_seconds"}),
        ("compare", "paper", {"rays": 0, "checked_penalty": [1.0]}, {"checked_penalty", "proof_seconds"}),
        ("certify", "paper", {"draws": 5, "overshoot": 3, "duration": 2}, {"proof_seconds"}),
        ("certify", "paper", {"draws": 5, "via": [(0.1,)]}, {"proof_seconds", "draws"}),
        (
            "certify", "paper", {"degrees": 2, "draws": 5, "overshoot": 3, "duration": 2, "via": [(0.1,)]},
            {"proof_seconds", "draws", "overshoot", "duration", "via"},
        ),
        ("certify", "paper", {"degrees": 2, "preset": "proved", "overshoot": 3, "draws": 5}, {"overshoot", "draws"}),
        ("certify", "paper", {"degrees": 2, "preset": "damped", "start": 0.1, "peak_effort": 60, "draws": 5}, set()),
    ],
)  # fmt: skip
def test_what_cannot_act_is_known(command: str, robot: str, fields: dict[str, Any], idle: set[str]) -> None:
    always = {
        "checked_gamma_ratio",
        "measurement_noise",
        "shaping",
        "estimator",
        "measured",
        "proof_seconds",
        "seed",
    }
    fields = {k: [v] if k in ("degrees", "start") else v for k, v in fields.items()} | {"pose": "5deg"}
    found = set(without_effect(command, fh.load_robot(robot), Specification(**fields)))
    assert found & {*fields, *idle} == idle
    assert found <= {*fields, *always}


def test_the_checked_gain_is_not_that_of_all_tolerances() -> None:
    robot, s = fh.load_robot("paper"), Specification(pose="home", degrees=(2,))
    assert "checked_gamma_ratio" in without_effect("certify", robot, s, tolerances=True)
    assert "checked_gamma_ratio" not in without_effect("certify", robot, s)
    assert "measured" not in without_effect("certify", robot, s, observer=True)
    fed_back = Specification(pose="home", degrees=(2, 4), estimator="none")
    assert "measured" in without_effect("certify", robot, fed_back)
    assert "measured" not in without_effect("certify", robot, fed_back, observer=True)


def test_what_a_run_does_not_depend_on() -> None:
    robot, way = fh.load_robot("paper"), {"time": (0.0, 1.0), "joint": (0.0, 0.2)}
    step = Specification(pose=(0.3,), start=(0.1,), overshoot=3.0, tracking_error=(0.1,), shaping="quintic")
    assert set(without_effect_on_run(step, robot, True, True)) == {"tracking_error"}
    assert set(without_effect_on_run(step, robot, True, False)) == {"tracking_error", "shaping"}
    assert {"seed", "measurement_noise"} <= set(without_effect_on_run(step, robot, False, True))
    moved = Specification(move=way, pose=(0.3,), start=(0.1,), overshoot=3.0, tracking_error=(0.1,))
    assert set(without_effect_on_run(moved, robot, True, True)) == {"pose", "start", "overshoot"}


@pytest.mark.parametrize(
    ("words", "option"),
    [
        ("design paper --pose 90deg --tracking-error 1deg", "--tracking-error"),
        ("design arm.toml --draws 5", "--draws"),
        ("design paper --pose home --estimator none --set rays=0 --draws 0 --seed 5", "--seed"),
        ("design paper --estimator none --measured motor_position,link_position", "--measured"),
        ("design paper --estimator none --measured motor_position --pose 5deg", "--measured"),
        ("design paper --set gamma_ratio=1.5", "--set gamma_ratio"),
        ("design paper --pose home --set rays=0 --set checked_gamma_ratio=2", "--set checked_gamma_ratio"),
        ("compare paper --pose home --set rays=0 --set proof_seconds=5", "--set proof_seconds"),
        ("certify paper --pose home --degrees 2 --overshoot 3", "--overshoot"),
        ("certify paper --pose home --tolerances --set checked_gamma_ratio=2", "--set checked_gamma_ratio"),
        ("certify paper --pose home --preset proved --decay 0.1", "--decay"),
        ("certify paper --pose home --preset proved --observer 10", "--observer"),
        ("certify paper --observer=-1", "--observer"),
        ("compile design.toml --processor arm", "--processor"),
        ("certify paper --pose home --degrees 2 --preset paper --peak-effort 30", "--peak-effort"),
        ("run design.toml --mujoco --load-at 1s", "--load-at"),
        ("run design.toml --mujoco --no-noise --seed 1", "--seed"),
        ("campaign design.toml --starts 3", "--starts"),
        ("campaign design.toml --metric gain", "--metric"),
        ("campaign design.toml --worst-case --metric gain --starts 3", "--starts"),
    ],
)
def test_what_would_be_ignored_is_refused(
    words: str, option: str, arm: str, folder: Path, refused: Callable[..., str]
) -> None:
    (folder / "arm.toml").write_text(arm, encoding="utf-8")
    (folder / "design.toml").write_text(
        "[design]\nrobot = 'paper'\npose = '5deg'\nstart = '0'\nrays = 0\ndraws = 0\n"
        "degrees = [2]\nestimator = 'ekf'\nproof_seconds = 0\npreset = 'paper'\n",
        encoding="utf-8",
    )
    told = refused(words.split(), option, folder)
    assert option in told.splitlines()[0]


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (
            "run design.toml --mujoco --load-at 1s",
            "--load,",
        ),  # an option of the run, where a design has a setting
        ("certify --check proof --set checked_gamma_ratio=2", "--set checked_gamma_ratio"),
        ("certify paper --angle-unit deg", "--set angle_unit=deg is an option of flexhinf design"),
    ],
)
def test_what_is_named_can_be_stated(
    words: str, named: str, folder: Path, refused: Callable[..., str]
) -> None:
    (folder / "design.toml").write_text("[design]\nrobot = 'paper'\npose = '5deg'\n", encoding="utf-8")
    refused(words.split(), named, folder)


def test_the_help_of_laws_names_them_all_and_loads_no_synthesis() -> None:
    text = declared(CompareOptions)["laws"].about.text
    assert [name for name in LAWS if name not in re.split(r"[ ,;.]+", text)] == []
    code = (
        "import sys, flexhinf.cli.options; assert 'flexhinf.designs.laws.torque' in sys.modules;"
        "models = {'flexhinf.plant', 'flexhinf.hinf', 'flexhinf.designs.pipeline', 'casadi', 'scipy'};"
        "print(models & set(sys.modules))"
    )
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert outcome.stdout.strip() == "set()"


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_every_option_of_a_command_is_passed_on_or_read(path: tuple[str, ...]) -> None:
    """As a field of a specification or of what the command is of, or as ``o.name`` in its file."""
    function = inspect.unwrap(COMMANDS[path].callback)
    files = [inspect.getfile(with_options), sys.modules[function.__module__].__file__]
    if path == ("check",):  # it reads a log as the others do
        files += [inspect.getfile(read_stated), inspect.getfile(check_log)]
    source = "\n".join(Path(str(file)).read_text(encoding="utf-8") for file in files)
    whole = declared({"campaign": CampaignOptions, "paper": PaperSettings}.get(path[0], Specification))
    for name in function.options:
        taken = f"o.{name}" in source or f'read.get("{name}")' in source  # by its command, or for every one
        assert name in function.fields or name in whole or taken, name


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_an_option_has_the_name_of_its_field(path: tuple[str, ...]) -> None:
    function = inspect.unwrap(COMMANDS[path].callback)
    for parameter in COMMANDS[path].params:
        if parameter.name in function.options and parameter.param_type_name == "option":
            assert parameter.opts == [option_name(parameter.name)]
            assert parameter.rich_help_panel is not None


def test_every_long_command_uses_the_threads_that_are_stated(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before it writes, and no longer than it runs. More than there are processors are told."""
    monkeypatch.setattr(arguments, "available", lambda: 3)
    seen, usual = list[int](), thread_count()

    def stop(out: Path) -> Path:
        seen.append(thread_count())
        raise InvalidInput("Enough.", "expected this", "nothing")

    monkeypatch.setattr(report, "check", stop)
    for words in (
        ["design", "planar-two-link"],
        ["compare", "paper", "--pose", "5deg"],
        ["certify", "paper"],
        ["paper"],
        ["identify", "log.csv", "--robot", "paper"],
    ):
        assert main([*words, "--threads", "3"]) == 2
        assert "threads" not in capsys.readouterr().err
        assert main([*words, "--threads", "4"]) == 2
        assert unnamed(capsys.readouterr().err, "note: --threads 4", "the 3 processors") == []
    assert seen == [3, 4] * 5
    assert thread_count() == usual
    long = {
        " ".join(path) for path, one in COMMANDS.items() if "threads" in inspect.unwrap(one.callback).options
    }
    assert long == {
        "design", "compare", "certify", "paper", "campaign run", "campaign compare", "identify", "studio",
    }  # fmt: skip


def test_a_design_has_forty_options_at_most() -> None:
    design = COMMANDS[("design",)]
    assert sum(one.param_type_name == "option" and one.name != "help" for one in design.params) <= 40


@pytest.mark.parametrize(("command", "fields"), [("certify", CERTIFY_FIELDS), ("run", RUN_FIELDS)])
def test_what_a_command_does_not_take_is_refused_with_the_commands_that_do(
    command: str, fields: tuple[str, ...], folder: Path, refused: Callable[..., str]
) -> None:
    own = inspect.unwrap(COMMANDS[(command,)].callback).options
    for name, field in FIELDS.items():
        if name not in own and name not in fields:
            words = [] if isinstance(field.default, bool) else [field.about.example]
            told = refused(
                [command, "paper", option_name(name), *words], f"{option_name(name)}, which would", folder
            )
            assert "flexhinf design" in told
            assert f"flexhinf {command}," not in told.split("try:")[1]


def commands_of(group: Any, path: str = "flexhinf") -> Iterator[tuple[str, Any]]:
    """Every command and group under a group, by what is typed."""
    yield path, group
    for name, command in getattr(group, "commands", {}).items():
        yield from commands_of(command, f"{path} {name}")


def test_what_stands_in_brackets_stays_in_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    """rich takes it for a style, and drops it."""
    assert main(["studio", "--help"]) == 0
    assert "flexhinf[studio]" in capsys.readouterr().out
    for path, command in commands_of(get_command(app)):
        texts = [command.help, command.epilog, *(getattr(entry, "help", "") for entry in command.params)]
        assert not re.search(r"(?<!\\)\[", " ".join(filter(None, texts))), path


def test_what_the_readme_types_stands_in_the_help() -> None:
    """And not in --help-all alone."""
    text = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    typed = dict(commands_of(get_command(app)))
    found = re.findall(r"^(flexhinf (?:(?:export|campaign) )?[a-z]+)(.*)$", text, re.MULTILINE)
    lines = [(path, words) for path, words in found if path in typed]
    assert len(lines) >= 3
    for path, words in lines:
        shown = {name for entry in typed[path].params if not entry.hidden for name in entry.opts}
        assert {*re.findall(r"--[a-z-]+", words.partition("#")[0])} <= shown, path
