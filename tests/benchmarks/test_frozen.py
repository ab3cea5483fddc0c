"""``python -m benchmarks.frozen``: what counts as a difference, what fails, and that each one kept has its reason."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.frozen import __main__ as command, tree
from benchmarks.frozen.compare import Difference, differences, help_diff, row_of, table
from benchmarks.frozen.reasons import BEFORE, REASONS, Reason
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.cli.commands import app

ROW = {
    "what": "overshoot",
    "joint": "",
    "where": "the step",
    "limit": 1.0,
    "found": 0.5,
    "unit": "%",
    "met": True,
}
OTHER = {**ROW, "what": "settling", "where": "the worst of 20"}


def read(
    rows: Sequence[Mapping[str, Any]] = (ROW,),
    met: bool = True,
    export: Mapping[str, Any] | None = None,
    gain: float = 2.0,
    **groups: Any,
) -> dict[str, Any]:
    known = {"bits": {"γ": 2.0}, "loop": {"gains at its pose": [1e-9, gain]}, "report": {"peak": 3.0}}
    return {"met": met, "requirements": list(rows), "groups": {**known, **groups}, "export": export}


def exported(code: str = "a", text: str = "b", u: float = 1.0, answers: bool = True) -> dict[str, Any]:
    digests = {"arm.c": code, "README.md": text}
    return {"digests": digests, "vector": {"arm_test: expected_u": [u, 0.0]}, "answers as recorded": answers}


@pytest.mark.parametrize(
    ("before", "after", "weights"),
    [
        (read(), read(), []),
        (read(), read(bits={"γ": math.nextafter(2.0, 3.0)}), ["bits"]),
        (read(), read(bits={}), ["bits"]),
        (read(gain=2.0), read(gain=2.0 + 1e-9), ["rounding"]),
        (read(gain=2.0), read(gain=2.0 + 1e-5), ["moved"]),
        (read(loop={"x": [1.0, math.nan]}), read(loop={"x": [1.0, math.nan]}), []),
        (read(loop={"x": [math.inf, 1.0]}), read(loop={"x": [math.inf, 2.0]}), ["moved"]),
        (read(loop={"x": [math.inf, 1.0]}), read(loop={"x": [5.0, 1.0]}), ["moved"]),
        (read(loop={"x": [1.0, 2.0]}), read(loop={"x": [1.0]}), ["moved"]),
        (read(), read([{**ROW, "found": 0.51}]), ["moved"]),
        (read(), read([{**ROW, "limit": 0.9}]), ["moved"]),
        (read(), read([{**ROW, "met": False}], met=False), ["verdict", "verdict"]),
        (read(), read([{**ROW, "where": "the move"}]), ["text"]),
        (read([ROW, OTHER]), read([OTHER, ROW]), []),
        (read([ROW, OTHER]), read([OTHER]), ["moved"]),
        (read(), read([ROW, OTHER]), ["moved"]),
        (read(), read(report={"peak of the step": 3.0}), ["gone", "new"]),
        (read(export=exported()), read(export=exported(text="c")), ["text"]),
        (read(export=exported()), read(export=exported(code="c")), ["moved"]),
        (read(export=exported()), read(export=exported(u=1.1)), ["moved"]),
        (read(export=exported()), read(export=exported(answers=False)), ["verdict"]),
    ],
)
def test_what_is_apart(before: dict[str, Any], after: dict[str, Any], weights: list[str]) -> None:
    assert [each.weight for each in differences("x", before, after, ())] == weights


def test_a_reason_excuses_a_number_with_both_its_values_and_neither_law_nor_verdict() -> None:
    moved = read([{**ROW, "found": 1.5, "met": False}], gain=4.0, bits={"γ": 3.0})
    reasons = [
        Reason("x*", "overshoot*, found", 0.5, 1.5, "another run"),
        Reason("x", "*gains*", 2.0, 5.0, "a value that is no longer found"),
        Reason("x", "*γ", 2.0, 3.0, "none counts"),
        Reason("x", "*verdict", "met", "not met", "none counts"),
    ]
    found = {each.item: each for each in differences("x", read(), moved, reasons)}
    assert {name: (each.why, each.fails) for name, each in found.items()} == {
        "overshoot (the step), verdict": ("", True),
        "overshoot (the step), found": ("another run", False),
        "bits: γ": ("", True),
        "loop: gains at its pose": ("", True),
    }
    cells = table([row_of("x", read(), moved, list(found.values()))]).splitlines()[-1].split(" | ")
    assert cells[0] == "| x"
    assert "→ not met" in cells[2]
    assert unnamed(cells[3], 1, "another run", 0.5, 1.5) == []


@pytest.mark.parametrize(("gain", "fails"), [(2.0, 0), (2.0 + 1e-9, 0), (2.1, 1)])
def test_the_exit_code_says_whether_something_moved_without_a_reason(
    gain: float,
    fails: int,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def of_tree(*_: Any) -> Iterator[tuple[str, dict[str, Any]]]:
        yield from ((name, read(gain=gain)) for name in tree.CASES)
        yield tree.COMMANDS, {"help": {"flexhinf": "two\nthree"}}

    before = [*((name, read()) for name in tree.CASES), (tree.COMMANDS, {"help": {"flexhinf": "one\nthree"}})]
    monkeypatch.setattr(command, "of_commit", lambda *_: before)
    monkeypatch.setattr(command, "of_tree", of_tree)
    kept = tmp_path / "kept.json"
    assert command.main(["--kept", str(kept)]) == fails
    said = capsys.readouterr().out
    assert unnamed(said, f"{10 * fails} other", f"{10 * fails} of them") == []
    assert "-one" in said
    assert "+two" in said
    assert len(json.loads(kept.read_text(encoding="utf-8"))["rows"]) == len(tree.CASES)


def test_another_gamma_is_found_in_law_gamma_gains_and_report(tmp_path: Path) -> None:
    quick = {"degrees": "2", "draws": 0, "rays": 0, "proof_seconds": 0}
    stated = {"pose": "10deg", "start": "0", "estimator": "none", **quick}
    one, again, other = (
        tree.read_design(tree.Case("paper", {**stated, "gamma_ratio": ratio}), tmp_path / folder)
        for ratio, folder in ((1.5, "one"), (1.5, "again"), (1.6, "other"))
    )
    assert differences("paper", one, again, ()) == []
    found = {each.item: each for each in differences("paper", one, other, ())}
    assert {"bits: γ", "bits: coefficients of V", "bits: SHA-256 of the law", "controller: laws.0.data"} <= {
        name for name, each in found.items() if each.weight == "bits"
    }
    assert {"loop: gains at its pose", "loop: poles at its pose", "result: gamma", "report: facts.gamma"} <= {
        name for name, each in found.items() if each.weight == "moved"
    }
    assert found["bits: γ"].after / found["bits: γ"].before == pytest.approx(1.6 / 1.5)  # type: ignore[operator]
    assert "bits: γ*" not in found
    law = fh.load_controller(tmp_path / "one").law
    assert one["groups"]["controller"]["laws.0.data"] == np.ravel(law.law_data).tolist()


def test_code_is_compared_without_its_comments_and_the_day(tmp_path: Path) -> None:
    source, told = tmp_path / "arm.c", tmp_path / "README.md"
    source.write_text(
        '/* on 2026-11-30 */ say("/* u */ // v"); // x\n' + f'digest = "{64 * "a"}";', encoding="utf-8"
    )
    told.write_text(f"made 2026-11-30 /* u */ at {40 * 'b'}", encoding="utf-8")
    assert tree.lasting(source) == ' say("/* u */ // v"); \ndigest = "";'
    assert tree.lasting(told) == "made  /* u */ at "


def test_numbers_of_a_test_vector_are_read() -> None:
    text = """static const arm_real u[ROWS][2] = {{1.5, -2e-3f},\n {NAN, -INFINITY}};
    static const uint32_t memory[2] = { 0x1fu, 7u };
    static const char *const names[PARTS] = { "", ", provoked" };
    static const int n = 3;"""
    found = tree.c_arrays(text)
    assert list(found) == ["u", "memory"]
    np.testing.assert_array_equal(found["u"], [1.5, -2e-3, np.nan, -np.inf])
    assert found["memory"] == [31.0, 7.0]


def test_tables_are_read_by_name_and_rows_of_requirements_left_out() -> None:
    page = {"a": {"b": 1, "cpu_s": 2}, "joints": [{"x": 1.0, "y": "l"}, {"x": None, "y": "r"}], "rows": [ROW]}
    found = dict(tree.flat(page))
    assert math.isnan(found["joints[].x"].pop())
    assert found == {"a.b": 1.0, "joints[].x": [1.0], "joints[].y": "l, r"}


def test_every_command_is_asked_for_help(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    with pytest.raises(SystemExit):
        app(["--help"])
    said = capsys.readouterr().out
    names = {each.name for each in (*app.registered_commands, *app.registered_groups)}
    assert set(tree.commands(said)) == names
    assert len(names) > 10
    assert list(help_diff({"a": "x\ny"}, {"a": "x\nz"})) == [
        ("a", "--- before\n+++ after\n@@ -2 +2 @@\n-y\n+z")
    ]


def test_every_difference_that_is_kept_has_its_reason_and_every_reason_its_difference() -> None:
    kept = json.loads(command.KEPT.read_text(encoding="utf-8"))
    assert kept["before"] == BEFORE
    assert [row["design"] for row in kept["rows"]] == list(tree.CASES)
    assert sum(row["exported"] for row in kept["rows"]) == 4
    found = [(row["design"], Difference(**each)) for row in kept["rows"] for each in row["differences"]]
    assert [each for _, each in found if each.fails] == []
    used = [
        any(reason.covers(name, each.item, each.before, each.after) for name, each in found)
        for reason in REASONS
    ]
    assert all(used)
