"""The gate for what comes from outside: what it lets through, what it refuses, in which time and in how many words."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.plant import Penalty
from flexhinf.validation import checked_name, read_toml, read_xml, real_array, real_number, value_text

SECONDS = 1.0
"""Processor time within which any file is refused."""

CALLS = 2_000_000
"""Calls of functions within which any file is refused: what is not timed is the same on a busy machine."""

SENTENCES = 2000
"""Characters: a message of a few lines."""


@pytest.mark.parametrize(
    "value",
    ["1.0", b"1", 1j, np.array([1j]), np.str_("1"), 10**400, [10**5000], [[1.0], [1.0, 2.0]], object(),
     np.datetime64("2020-01-01"), {"a": 1}],
)  # fmt: skip
def test_what_is_no_real_number_is_nan(value: object) -> None:
    array = real_array(value)
    assert array.shape == ()
    assert np.isnan(array)
    assert np.isnan(real_number(value))
    with pytest.raises(ValueError, match="real"):
        real_array(value, strict=True)


def test_missing_entries_are_nan() -> None:
    masked = np.ma.array([1.0, 2.0], mask=[True, False])
    for value in (masked, [np.ma.masked, 2.0], (np.ma.masked, 2), [None, 2.0]):
        np.testing.assert_array_equal(real_array(value), [np.nan, 2.0])
    np.testing.assert_array_equal(real_array([masked, [3.0, 4.0]]), [[np.nan, 2.0], [3.0, 4.0]])
    assert np.isnan(real_number(np.ma.masked))


def test_real_numbers_stay_as_they_are_and_are_copied() -> None:
    given = np.array([1.0, np.inf, np.nan])
    found = real_array(given)
    np.testing.assert_array_equal(found, given)
    assert not np.shares_memory(found, given)
    for value in ([1, 2.5, True], (1, 2.5, 1), np.array([1, 2.5, 1], dtype=object), np.float32([1, 2.5, 1])):
        np.testing.assert_array_equal(real_array(value), [1.0, 2.5, 1.0])


@pytest.mark.parametrize("masked", [np.ma.masked, [np.ma.masked], np.ma.array([0.5], mask=[True])])
def test_a_masked_number_is_refused_wherever_arrays_are_taken(masked: object) -> None:
    robot = fh.paper_arm()
    for refused in (
        lambda: robot.operating_point(masked),
        lambda: robot.problem(Penalty([1.0] * 5, effort=masked)),
        lambda: robot.plant().derivative(np.zeros(4), masked),
        lambda: robot.problem(np.ma.array(np.eye(5), mask=np.eye(5))),
        lambda: robot.inverse_dynamics(masked),
        lambda: robot.with_values({"mass": masked}),
        lambda: fh.Step(masked, at=0.0),
        lambda: fh.UnscentedKalmanFilter(robot.plant(), 1e-3, masked, 1e-6, np.zeros(4), 1e-4),
        lambda: fh.UnscentedKalmanFilter(robot.plant(), 1e-3, 1e-6, 1e-6, np.zeros(4), 1e-4).predict(masked),
    ):
        with pytest.raises(FlexhinfError):
            refused()


@pytest.mark.parametrize(
    "name",
    [
        "",
        " ",
        "a b",
        "a\nb",
        "a\x1b[31mb",
        "a\u202eb",
        "a\u200bb",
        "\u0301",
        "a\x00",
        "a" * 101,
        None,
        3,
        b"a",
        "\ud800",
    ],
)
def test_names_that_cannot_be_printed_are_refused(name: object) -> None:
    with pytest.raises(InvalidInput, match="joint") as caught:
        checked_name("a joint", name)
    assert str(caught.value).replace("\n", "").isprintable()
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize("name", ["elbow", "左肘", "q$1$", "[red]", "<b>", "url(", "😀", "a-b_c.d"])
def test_names_of_any_script_and_markup_are_taken(name: str) -> None:
    assert checked_name("a joint", name) == name


def test_messages_are_a_few_lines_without_control_characters() -> None:
    error = InvalidInput("x" * 60_000_000, "line\n" * 1000, "a\x1b[2J\u202eb")
    text = str(error)
    assert len(text) < SENTENCES
    assert text.count("\n") < 20
    assert text.replace("\n", "").isprintable()
    assert "59999550 characters" in error.what
    assert error.advice == r"a\x1b[2J\u202eb"


def test_any_value_has_a_short_text() -> None:
    class Foreign:
        def __repr__(self) -> str:
            raise RuntimeError("no")

    deep: list = []
    for _ in range(100_000):
        deep = [deep]
    for value in (10**5000, Foreign(), deep, "a" * 10**6):
        assert 0 < len(value_text(value)) < 400


TOO_MUCH_TOML = (
    [
        ("x = " + "[" * 900 + "]" * 900, "nested"),
        ("x = " + "{a = " * 900 + "1" + "}" * 900, "nested"),
        ("x = " + "9" * 4301, "no TOML"),
        ("a." * 200_000 + "a = 1", "many parts"),
        ("1." * 200_000 + "1 = 1", "many parts"),
        ('"a"."b".' * 50_000 + "a = 1", "many parts"),
        ("[" + "a." * 200_000 + "a]", "many parts"),
        ('"\\' * 400_000, "no TOML"),
        ("x = [" + "0.5," * 2_000_000 + "]", "large"),
        ('x = """' + "\\" * 900_000, "no TOML"),
        ("x = 1\nx = 2", "no TOML"),
    ]
)  # fmt: skip


@pytest.mark.quick_cases(4)
@pytest.mark.parametrize(("text", "what"), TOO_MUCH_TOML)
def test_what_is_too_deep_or_too_large_is_refused_with_little_work(
    tmp_path: Path, text: str, what: str, bounded_work: Callable[[int], AbstractContextManager[None]]
) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match=what) as caught, bounded_work(CALLS):
        read_toml(path)
    assert what in caught.value.what
    assert len(str(caught.value)) < SENTENCES


def test_dots_and_brackets_inside_of_texts_and_comments_do_not_count(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    dots = "." * 100 + "[" * 100
    path.write_text(
        f'a = "{dots}\\"{dots}"  # {dots}\nb = \'{dots}\'\nc = """\n{dots}"{dots}"""\nd = \'\'\'{dots}\'{dots}\'\'\'\n'
        f"e = [{'0.5, ' * 100}]\n",
        encoding="utf-8",
    )
    assert read_toml(path)["e"] == [0.5] * 100


TOO_MUCH_XML = [
    ("<robot>" + "<a>" * 900 + "</a>" * 900 + "</robot>", "nested"),
    ("<robot>" + "<a/>" * 200_000 + "</robot>", "many elements"),
    ('<!DOCTYPE r [<!ENTITY a "aaaa">]><robot>&a;</robot>', "document type"),
    ("<robot>", "no XML"),
    ("", "no XML"),
    ("<robot>" + " " * 11_000_000 + "</robot>", "large"),
]


@pytest.mark.ci("long texts")
@pytest.mark.parametrize(("text", "what"), TOO_MUCH_XML)
def test_xml_that_no_robot_needs_is_refused_with_little_work(
    tmp_path: Path, text: str, what: str, bounded_work: Callable[[int], AbstractContextManager[None]]
) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match=what), bounded_work(CALLS):
        read_xml(path)


REFUSALS = """
import sys, time
from pathlib import Path
from flexhinf.errors import InvalidInput
from flexhinf.validation import read_toml, read_xml

read = {"toml": read_toml, "xml": read_xml}[sys.argv[1]]
for path in sys.argv[2:]:
    start = time.thread_time()
    try:
        read(Path(path))
    except InvalidInput:
        print(time.thread_time() - start)
"""


@pytest.mark.ci("reads every large file three times in interpreters of their own")
@pytest.mark.parametrize(("kind", "cases"), [("toml", TOO_MUCH_TOML), ("xml", TOO_MUCH_XML)])
def test_each_of_them_is_refused_in_a_second(tmp_path: Path, kind: str, cases: list[tuple[str, str]]) -> None:
    """In an interpreter of its own: what other tests hold in memory or trace is not counted."""
    paths = [tmp_path / f"{k}.{kind}" for k in range(len(cases))]
    for path, (text, _) in zip(paths, cases, strict=True):
        path.write_text(text, encoding="utf-8")
    runs = [
        subprocess.run(
            [sys.executable, "-c", REFUSALS, kind, *map(str, paths)],
            capture_output=True,
            text=True,
            check=True,
        )
        for _ in range(3)  # the least of them: what else runs on the machine only adds
    ]
    taken = np.array([[float(line) for line in run.stdout.split()] for run in runs])
    assert taken.shape == (3, len(cases))
    assert taken.min(axis=0).max() < SECONDS


def test_what_cannot_be_read_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "bytes.toml").write_bytes(b"x = '\xff'")
    for name, what in (
        ("bytes.toml", "UTF-8"),
        ("nowhere.toml", "nowhere.toml"),
        ("pipe.toml", "pipe.toml"),
        ("", "robot file"),
    ):
        with pytest.raises(InvalidInput, match=what):
            read_toml(tmp_path / name)


def test_more_work_than_its_bound_is_noticed(
    bounded_work: Callable[[int], AbstractContextManager[None]],
) -> None:
    for most, error in ((2000, None), (20, AssertionError)):
        with nullcontext() if error is None else pytest.raises(error), bounded_work(most):
            for _ in range(30):
                value_text(1)
    with pytest.raises(AssertionError), bounded_work(1):
        raise ValueError(value_text("refused"))
