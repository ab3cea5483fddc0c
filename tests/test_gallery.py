"""Programs of the gallery: pages whose truths `make docs` checks when it runs them, and that what is false fails it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

#: Programs for the command line, which are one block.
ONE_BLOCK = {"region_of_validity"}

EXAMPLES = sorted(file.stem for file in (Path(__file__).resolve().parents[1] / "examples").glob("*.py"))


@pytest.fixture(scope="module")
def truths(website: Callable[[str], Any]) -> Any:
    return website("truths")


def test_every_example_has_a_truth(truths: Any) -> None:
    assert sorted(truths.TRUE) == EXAMPLES
    assert set(truths.LARGER) <= set(EXAMPLES)


@pytest.mark.parametrize("name", [name for name in EXAMPLES if name not in ONE_BLOCK])
def test_a_program_is_a_page(repository: Path, name: str) -> None:
    """A title, blocks with a sentence each, and little code."""
    text = (repository / "examples" / f"{name}.py").read_text(encoding="utf-8")
    title, underline = text.splitlines()[1:3]
    assert underline == "=" * len(title)
    assert text.count("\n# %%\n") >= 2
    code = [
        line for line in text.split('"""', 2)[2].splitlines() if line.strip() and not line.startswith("#")
    ]
    assert len(code) <= 60
    for block in re.split(r"^# %%\n", text, flags=re.MULTILINE)[1:]:
        assert block.strip()


# The check of `make docs` -----------------------------------------------------------------------------
def figure(width: float = 7.0, height: float = 5.0, *labels: str, shared: bool = False) -> Any:
    """A panel for each label; an empty one is none."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(width, height))
    panels = drawn.subplots(len(labels), squeeze=False, sharex=shared).flat if labels else ()
    for panel, label in zip(panels, labels, strict=True):
        panel.set_xlabel(label)
    return drawn


def test_a_true_page_passes(truths: Any) -> None:
    good = {"final": 0.001, "largest": 0.3}
    truths.check("two_link_arm", good, [figure(7.0, 5.0, "t (s)")], "line\n" * 12)
    truths.check("two_link_arm", good, [figure(7.0, 5.0, "t (s)", "t (s)", "", shared=True)])


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"example_globals": {"final": 0.003, "largest": 0.3}}, "false"),
        ({"figures": []}, "draws nothing"),
        ({"figures": [(7.1, 5.0, "t (s)")]}, "7.1 x 5 inches; at"),
        ({"figures": [(7.0, 5.1, "t (s)")]}, "7 x 5.1 inches; at"),
        ({"figures": [(7.0, 5.0, "t (s)"), (7.0, 5.0, "t (s)", "t (s)", "")]}, "1 of 3 axes"),
        ({"printed": "line\n" * 13}, "13 lines; at"),
        ({"files": ["arm.csv", "arm.png"]}, "arm.csv, arm.png"),
    ],
)
def test_what_is_false_fails_the_build(truths: Any, changed: dict[str, Any], named: str) -> None:
    page = {"example_globals": {"final": 0.001, "largest": 0.3}, "figures": [(7.0, 5.0, "t (s)")]} | changed
    page["figures"] = [figure(*size) for size in page["figures"]]
    with pytest.raises(truths.Untrue, match=named) as caught:
        truths.check("two_link_arm", **page)
    assert str(caught.value).startswith("two_link_arm")
    assert str(caught.value).count("; ") == named.count("; ")  # and nothing else


def test_too_many_panels_of_shared_axes_have_no_label(truths: Any) -> None:
    bare = figure(7.0, 5.0, "", "", "t (s)", shared=True)
    with pytest.raises(truths.Untrue, match="2 of 3 axes"):
        truths.check("two_link_arm", {"final": 0.001, "largest": 0.3}, [bare])


def test_a_global_that_is_gone_is_an_error(truths: Any) -> None:
    with pytest.raises(AttributeError, match="final"):
        truths.check("two_link_arm", {"largest": 0.3}, [figure(7.0, 5.0, "t (s)")])


def test_a_build_runs_again_what_ran_with_another_package(
    website: Callable[[str], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pages and notebooks that ran are kept as long as the package and the checks are the same."""
    from tests import store

    gallery = website("gallery")

    monkeypatch.setattr(gallery, "ROOT", tmp_path)
    page, notebook = (
        tmp_path / "docs" / "gallery" / "arms" / "latency.py.md5",
        tmp_path / "built" / "notebooks",
    )
    for digest, kept in (("one", False), ("one", True), ("two", False)):
        monkeypatch.setattr(store, "source_digest", lambda digest=digest: digest)
        page.parent.mkdir(parents=True, exist_ok=True)
        page.touch()
        notebook.mkdir(parents=True, exist_ok=True)
        gallery.forget_stale(tmp_path / "built")
        assert page.exists() is notebook.exists() is kept


def test_what_an_example_leaves_is_seen_and_staged_away(
    website: Callable[[str], Any], tmp_path: Path
) -> None:
    gallery = website("gallery")

    arms = gallery.stage(tmp_path) / "arms"
    staged = [file.stem for file in arms.glob("*.py")]
    assert "latency" in staged
    assert gallery.left_behind(arms, staged) == []
    (arms / "arm.csv").touch()
    (arms / "report").mkdir()
    assert {file.name for file in gallery.left_behind(arms, staged)} == {"arm.csv", "report"}
    gallery.stage(tmp_path)
    assert gallery.left_behind(arms, staged) == []
