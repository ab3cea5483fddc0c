"""A specification is declared once: command line, design file and schema agree, and a refusal says what is allowed."""

from __future__ import annotations

import dataclasses
import inspect
import itertools
import pydoc
from typing import Any

import pytest

import flexhinf as fh
from flexhinf.analysis import EquilibriumLoop
from flexhinf.cli.commands import app
from flexhinf.cli.messages import error_text, option_syntax
from flexhinf.designs import Specification
from flexhinf.designs.specification import FIELDS, SpecificationError
from flexhinf.errors import InvalidInput
from flexhinf.loop.simulation.program import LONGEST_LINEAR


def options(command: str) -> dict[str, Any]:
    from typer.main import get_command

    return {p.name: p for p in get_command(app).commands[command].params}  # type: ignore[attr-defined]


def test_every_field_has_its_option() -> None:
    design = options("design")
    for name, field in FIELDS.items():
        if field.about.setting:
            assert name not in design
            assert field.option.startswith(f"--set {name}")
            continue
        option = f"--{name.replace('_', '-')}"
        negative = {f"--no-{option[2:]}"} if isinstance(field.default, bool) else set()
        assert ({*design[name].opts}, {*design[name].secondary_opts}) == ({option}, negative)
        text = field.about.help.replace("[", r"\[")
        assert design[name].help.startswith(text) or text.startswith(design[name].help)


def test_the_default_of_an_option_is_that_of_its_field() -> None:
    for name, field in FIELDS.items():
        if field.default not in (None, ()) and not field.about.setting:
            shown = options("design")[name].default
            assert getattr(Specification(**{name: shown}), name) == field.default
        assert field.default is not None or field.about.default or name == "process_noise"


def test_the_options_of_a_group_stand_together_and_advanced_ones_last() -> None:
    groups = [p.rich_help_panel for p in options("design").values() if p.param_type_name == "option"]
    groups = [group for group in groups if group]
    assert len(list(itertools.groupby(groups))) == len(set(groups))
    assert (groups[0], groups[-1]) == (options("design")["elastic"].rich_help_panel, "Advanced")


def test_help_of_a_specification_names_every_field_without_the_types_that_read_it() -> None:
    text = pydoc.render_doc(Specification, renderer=pydoc.plaintext)
    assert "Annotated" not in text
    assert "pydantic" not in text.lower()
    for name, field in FIELDS.items():
        assert f" {name} : {field.allowed}; default: " in text
    assert "pose: 'options.Pose | None' = None" in str(inspect.signature(Specification))


def test_words_have_any_case() -> None:
    asked = Specification(preset="Robust", estimator="UKF", angle_unit="DEG")  # type: ignore[arg-type]
    assert (asked.preset, asked.estimator, asked.angle_unit) == ("robust", "ukf", "deg")


@pytest.mark.parametrize(
    ("fields", "found", "python", "option"),
    [
        ({"draws": -5}, ">= 0, got -5", "draws=200", "--draws 200"),
        ({"draws": 10**12}, "100000 (", "draws=200", "--draws 200"),
        ({"rays": 10**12}, "100000 (", "rays=1000", "--set rays=1000"),
        ({"gamma_ratio": 1e308}, "1e+06 (", "gamma_ratio=1.5", "--set gamma_ratio=1.5"),
        ({"checked_gamma_ratio": 1e308}, "1e+06 (", "checked_gamma_ratio=1.6", "--set checked_gamma_ratio=1.6"),
        ({"duration": -3.0}, "> 0, s, got -3.0", "duration=5.0", "--duration 5"),
        ({"unknown_delay": 500}, "500 s are 500000 samples", "unknown_delay='500ms'", "--unknown-delay 500ms"),
        ({"unknown_delay": 1.5e-3}, " 0.001 s, got 0.0015 s", "unknown_delay='5ms'", "--unknown-delay 5ms"),
        ({"period": 2}, "1e-5 to 0.1 s, got 2", "period='2ms'", "--period 2ms"),
        ({"duration": 5000}, "5000000 samples", "duration='5000ms'", "--duration 5000ms"),
        ({"preset": "smooth"}, "proved, got 'smooth'", "preset='damped'", "--preset damped"),
        ({"pose": "90grad"}, "deg", "pose=(0.3, -0.5)", "--pose 0.3,-0.5"),
        ({"mujoco": 1}, "false, got 1", "mujoco=True", "--mujoco"),
        ({"peak_sensitivity": 1.0}, "> 1, got 1.0", "peak_sensitivity=2.0", "--set peak_sensitivity=2"),
        ({"gain_margin": 0.5}, "> 1, got 0.5", "gain_margin=2.0", "--set gain_margin=2"),
        ({"dampng": 0.3}, "'dampng'", "'damping'", "'damping'"),
        ({"delay": 0.01}, "'delay'", "'unknown_delay'", "'unknown_delay'"),
        ({"delay_margin": 201}, "at most 200 (", "delay_margin=1.0", "--set delay_margin=1"),
        ({"latency": 11}, "at most 10 (", "latency=1", "--latency 1"),
        ({"latency": 1, "estimator": "none"}, "expected 0", "latency=0", "--latency 0"),
    ],
)  # fmt: skip
def test_a_refusal_names_value_and_range_in_the_syntax_of_its_user(
    fields: dict[str, Any], found: str, python: str, option: str
) -> None:
    with pytest.raises(SpecificationError) as caught:
        Specification(**fields)
    assert isinstance(caught.value, fh.InvalidInput)
    assert found in caught.value.found
    assert caught.value.advice == python
    assert error_text(caught.value).endswith(f"try:   {option}")


def test_latency_and_unknown_delay_are_states_of_one_linear_loop() -> None:
    assert Specification(latency=2, unknown_delay=0.198).unknown_samples == 198
    with pytest.raises(SpecificationError, match="198 samples"):
        Specification(latency=2, unknown_delay=0.199)


def test_a_specification_cannot_be_changed_but_replaced() -> None:
    asked = Specification(pose="90deg", bandwidth=[4, 6])  # type: ignore[arg-type]
    with pytest.raises(dataclasses.FrozenInstanceError):
        asked.seed = 3  # type: ignore[misc]
    other = dataclasses.replace(asked, seed=3)
    assert (other.seed, other.bandwidth, other.in_degrees) == (3, (4.0, 6.0), True)
    with pytest.raises(SpecificationError, match="seed"):
        dataclasses.replace(asked, seed=-1)


@pytest.mark.parametrize(
    ("python", "option"),
    [
        ("preset='damped'", "--preset damped"),
        ("a larger `peak_effort`, or start=(0.1, 0.2)", "a larger --peak-effort, or --start 0.1,0.2"),
        ("measured=('motor_position',)", "--measured motor_position"),
        ("feedforward=False", "--set feedforward=no"),
        ("robot.seed=3 stays", "robot.seed=3 stays"),
        ("leave 'pd' out of `laws`", "leave 'pd' out of --laws"),
    ],
)
def test_hints_are_put_into_the_syntax_of_the_command_line(python: str, option: str) -> None:
    assert option_syntax(python) == option


@pytest.mark.parametrize("samples", [30, 200, 201])
def test_specification_and_linear_loop_refuse_the_same_delays(samples: int) -> None:
    """The specification took 500 samples, of which the linear loop refused 300 after the weights had been searched."""
    robot = fh.paper_arm()
    plant, problem = robot.plant(), robot.problem()
    law = fh.linear_law(problem, 2.0 * fh.smallest_gamma(problem))
    makers = (
        lambda: Specification(unknown_delay=1e-3 * samples, latency=0),
        lambda: EquilibriumLoop(law, None, plant, 1e-3, delay=samples),
    )
    for make in makers:
        if samples <= LONGEST_LINEAR:
            make()
        else:
            with pytest.raises(InvalidInput, match=r" (0\.2 s, )?200 samples"):
                make()
