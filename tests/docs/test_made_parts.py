"""The parts of the pages that the code makes are what the code makes."""

from __future__ import annotations

import re
import runpy
import tomllib
from pathlib import Path
from typing import Any

import pytest

MAKE: dict[str, Any] = runpy.run_path(str(Path(__file__).resolve().parents[2] / "docs" / "make.py"))

NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[-+]?\d+)?")

#: Processors round differently, and searches amplify it: numbers of designs agree within this fraction, or one digit.
ROUNDING = 0.05


def numbers_apart(one: str, other: str) -> list[tuple[str, str]]:
    """Pairs of numbers at the same place of two texts that differ by more than rounding."""
    apart = []
    for a, b in zip(NUMBER.findall(one), NUMBER.findall(other), strict=True):
        digit = 10.0 ** -len(a.partition(".")[2]) if "e" not in a else 0.0
        if abs(float(a) - float(b)) > max(ROUNDING * abs(float(a)), 1.01 * digit):
            apart.append((a, b))
    return apart


#: A table of counts, which a test of its own compares with the numbers of the repository.
COUNTED = ("counts",)


@pytest.mark.costs("benchmarks make their tables in processes of their own")
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("name", [name for name in MAKE["QUICK"] if name not in COUNTED])
def test_a_part_is_what_the_code_makes(name: str, repository: Path) -> None:
    page = repository / MAKE["QUICK"][name][0]
    MAKE["DRAWN"].clear()
    assert MAKE["written"](name) == page.read_text(encoding="utf-8"), f"run: python docs/make.py {name}"
    for figure, drawn in MAKE["DRAWN"].items():
        assert figure.read_text(encoding="utf-8") == drawn, f"run: python docs/make.py {name}"


@pytest.mark.ci("parses the rooms that numbers pass through")
def test_numbers_are_followed_through_code_that_passes_them_on(repository: Path) -> None:
    assert runpy.run_path(str(repository / "docs" / "followed.py"))["broken"]() == []


@pytest.mark.ci("parses the package once more")
def test_counts_are_those_of_the_repository(repository: Path) -> None:
    """Who makes a sum larger writes it anew, and says in the file what was bought and what went."""
    made = runpy.run_path(str(repository / "docs" / "counts.py"))
    stated = tomllib.loads((repository / "docs" / "counts.toml").read_text(encoding="utf-8"))
    assert {part: stated[part] for part in made["counts"]()} == made["counts"](), "run: python docs/counts.py"
    for name in COUNTED:
        page, made_anew = (
            (repository / MAKE["QUICK"][name][0]).read_text(encoding="utf-8"),
            MAKE["written"](name),
        )
        assert numbers_apart(page, made_anew) == [], f"run: python docs/make.py {name}"


#: Parts of several designs; those of one are computed in `make ci`.
IN_NIGHTLY = {
    "presets": "designs the arm eight times",
    "circle": "identifies and designs twice", "step": "designs two links",
    "moves": "designs two links", "augmentation": "simulates every choice of noise",
}  # fmt: skip
#: Pictures whose commands run as they are printed in tests/docs/test_commands.py, or take long.
IN_NIGHTLY |= {
    f"picture-{page.rpartition('/')[2]}": "the block of a page once more, which tests run as it is printed"
    for page in runpy.run_path(str(Path(__file__).resolve().parents[2] / "docs" / "pictures.py"))["PICTURES"]
    if page not in ("robots", "estimators", "guides/own_plant")
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name,
            marks=pytest.mark.nightly(IN_NIGHTLY[name])
            if name in IN_NIGHTLY
            else pytest.mark.ci("designs or sweeps"),
        )
        for name in MAKE["SLOW"]
        if name != "promises"  # tests/test_fuzz.py
    ],
)
def test_the_numbers_of_a_page_are_those_of_the_code(name: str, repository: Path) -> None:
    page = (repository / MAKE["SLOW"][name][0]).read_text(encoding="utf-8")
    made = MAKE["written"](name)
    assert NUMBER.sub("#", made) == NUMBER.sub("#", page), f"run: python docs/make.py {name}"
    assert numbers_apart(page, made) == []


def test_a_stale_number_is_noticed() -> None:
    assert numbers_apart("1.50 s, 27 V, 400", "1.51 s, 28 V, 410") == []
    assert numbers_apart("1.50 s, 27 V", "1.42 s, 29.1 V") == [("1.50", "1.42"), ("27", "29.1")]
    assert numbers_apart("|7|1500|830|", "|7|1600|830|") == [("1500", "1600")]


def test_what_depends_on_the_processor_is_not_promised() -> None:
    """How many attempts are right and how many refused: a filter that rounds otherwise answers instead."""
    head = "| tried | attempts | right | refused by a typed error | neither |\n|---|---|---|---|---|\n"
    one, other = (f"{head}| estimators | 1000 | {right} | {1000 - right} | 0 |\n" for right in (983, 987))
    assert MAKE["without_division"](one) == MAKE["without_division"](other)
    assert MAKE["without_division"](one).splitlines()[-1] == "| estimators | 1000 | 0 |"
    assert MAKE["without_division"](one) != MAKE["without_division"](one.replace("| 0 |", "| 1 |"))
