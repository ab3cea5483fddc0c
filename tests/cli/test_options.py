"""Every option of every command is read by what the command computes with; what would be ignored is refused."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

import flexhinf as fh
from flexhinf.cli.arguments import with_options
from flexhinf.cli.commands import app
from flexhinf.cli.options import CERTIFY_FIELDS, COMPARE_FIELDS, RUN_FIELDS
from flexhinf.design.specification import FIELDS, Specification
from flexhinf.options import CampaignOptions, declared, option_name
from flexhinf.paper import PaperSettings

#: Files that read every field to write it, to copy it or to check it, and compute nothing.
WRITERS = ("dataclasses.py", "options.py", "design_file.py", "arguments.py")

#: Properties of a specification that stand for a field.
BEHIND = {
    "peak_sensitivity_limit": "peak_sensitivity",
    "gain_margin_limit": "gain_margin",
    "known_latency": "latency",
    "unknown_samples": "unknown_delay",
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
        file = Path(sys._getframe(1).f_code.co_filename).name
        if name in BEHIND or (name in FIELDS and file not in (*WRITERS, "specification.py")):
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


@pytest.mark.slow
def test_a_certificate_is_made_with_every_field_that_certify_takes(read: set[str]) -> None:
    from flexhinf.design.certification import certify_design, evidence, proved

    def certified(**fields: Any) -> None:
        s = Specification(**fields)
        results = certify_design(fh.load_robot("paper"), s, lambda text: None, lambda cells, share: None)
        if results[0].certificate is not None:
            evidence(fh.load_robot("paper"), s, proved(results, None))

    certified(pose="20deg", degrees="2", preset="damped")
    certified(pose="20deg", degrees="2", preset="robust")
    assert set(CERTIFY_FIELDS) - read == set()


@pytest.mark.slow
def test_a_comparison_is_made_with_every_field_that_compare_takes(read: set[str], tmp_path: Path) -> None:
    way = tmp_path / "way.csv"
    way.write_text("time,link [deg]\n0,0\n2,20\n")
    s = Specification(move=str(way), shaping="quintic", preset="damped", start="0", **SMALL)
    fh.compare(fh.load_robot("vertical-rig"), s, ("pd",), "none").save(tmp_path / "report")
    assert set(COMPARE_FIELDS) - read == set()


@pytest.mark.slow
def test_a_design_is_made_with_every_field(read: set[str], tmp_path: Path) -> None:
    way = tmp_path / "way.csv"
    way.write_text("time,link [deg]\n0,0\n2,20\n")
    s = Specification(move=str(way), shaping="quintic", preset="damped", start="0", **SMALL)
    fh.design(fh.load_robot("vertical-rig"), s).save(tmp_path / "report")
    assert set(FIELDS) - read == set()


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_every_option_of_a_command_is_passed_on_or_read(path: tuple[str, ...]) -> None:
    """As a field of a specification or of what the command is of, or as ``o.name`` in its file."""
    function = inspect.unwrap(COMMANDS[path].callback)
    files = (inspect.getfile(with_options), sys.modules[function.__module__].__file__)
    source = "\n".join(Path(str(file)).read_text(encoding="utf-8") for file in files)
    whole = declared({"campaign": CampaignOptions, "paper": PaperSettings}.get(path[0], Specification))
    for name in function.options:
        assert name in function.fields or name in whole or f"o.{name}" in source, name


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_an_option_has_the_name_of_its_field(path: tuple[str, ...]) -> None:
    function = inspect.unwrap(COMMANDS[path].callback)
    for parameter in COMMANDS[path].params:
        if parameter.name in function.options and parameter.param_type_name == "option":
            assert parameter.opts == [option_name(parameter.name)]
            assert parameter.rich_help_panel is not None


@pytest.mark.parametrize(
    ("command", "fields"), [("certify", CERTIFY_FIELDS), ("compare", COMPARE_FIELDS), ("run", RUN_FIELDS)]
)
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
