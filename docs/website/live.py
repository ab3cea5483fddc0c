"""Live pages, made by ``flexhinf export web`` while the site is built, where this command and clang exist."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from unittest.mock import patch

from tests.store import COLUMNS, command, source_digest

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_PLACE = "<!-- made by the build: live pages -->"


class Arm(NamedTuple):
    """A live page: its title, and the design that it shows. A robot file lies beside this one; the words of options are
    those of a command of the documentation where one is alike, so that a run of CI makes each design once."""

    title: str
    robot: str
    options: str
    folder: str = "flexhinf-design"

    @property
    def words(self) -> tuple[str, ...]:
        """Those of ``flexhinf design``."""
        return (self.robot, *self.options.split())


ARMS = {
    "two-links": Arm(
        "Two links, one controller for the whole workspace",
        "planar-two-link",
        "--measured link_position,motor_position",
    ),
    "six-joints": Arm(
        "Six joints in space, one controller for the whole workspace",
        "six-joints.toml",
        "--measured link_position,motor_position --draws 2",  # the page shows none of the moves that judge it
    ),
    "paper": Arm(
        "One link, lifted against gravity",
        "paper",
        "--pose 90deg --start 0 --preset damped --degrees 4 --draws 0 --saturation 48 --out arm",
        "arm",
    ),
}


def missing() -> str:
    """What is missing for live pages; an empty text if nothing is."""
    programs = [name for name in ("clang", "wasm-ld") if shutil.which(name) is None]
    if programs:
        return f"{' and '.join(programs)} not found; clang and lld bring them"
    return ""


def make(folder: Path) -> list[str]:
    """Make the pages that are missing or old; the names of those that are there."""
    pages, stamp, made = folder / "live", folder / "digest", []
    files = [file.read_text(encoding="utf-8") for file in Path(__file__).parent.glob("*.toml")]
    now = f"{source_digest()} {ARMS!r} {files!r}"
    if not stamp.exists() or stamp.read_text(encoding="utf-8") != now:
        shutil.rmtree(folder, ignore_errors=True)
    pages.mkdir(parents=True, exist_ok=True)
    for name, arm in ARMS.items():
        page, work = pages / f"{name}.html", folder.parent / "live_designs" / name
        if not page.exists():
            shutil.rmtree(work, ignore_errors=True)
            work.mkdir(parents=True)
            if arm.robot.endswith(".toml"):
                shutil.copy(Path(__file__).with_name(arm.robot), work)
            with patch.dict(os.environ, COLUMNS=COLUMNS):
                command(("design", *arm.words), work)  # exit code 1 is a design too
                done = command(("export", "web", arm.folder, "--out", "live.html"), work)
            if done.code:
                from sphinx.util import logging  # here, as tests read this file without Sphinx

                logging.getLogger(__name__).warning(
                    "live page %s: %s", name, (done.errors or done.output).strip()
                )
                continue
            shutil.copy(work / "live.html", page)
        made.append(name)
    stamp.write_text(now, encoding="utf-8")
    return made


def frame(name: str) -> list[str]:
    """A live page within a page, and a link to it, as Markdown."""
    title = ARMS[name].title
    return [
        "```{raw} html",
        f'<iframe class="live" src="live/{name}.html" title="{title}" loading="lazy"></iframe>',
        f'<p><a href="live/{name}.html">{title}, on a page of its own</a></p>',
        "```",
        "",
    ]


def text(made: list[str], page: str) -> str:
    """What a page says of them: on the first page one runs; the page of all has all, or why there is none."""
    if page == "index":
        said = [
            "## Try it here",
            "",
            "The exported C of controllers and their arms runs here: left a design, right a stiff PD. Pull a link.",
        ]
        frames = [line for name in made[:2] for line in frame(name)]
        return "\n".join([*said, "", *frames, "More of them: [Live](live.md)."]) if made else ""
    if not made:
        return "This build has no live pages, because clang or wasm-ld was not found when it was made."
    return "\n".join(line for name in made for line in (f"## {ARMS[name].title}", "", *frame(name)))


def begin(app: Sphinx) -> None:
    """Handler of ``builder-inited``."""
    app.env.flexhinf_live = []  # type: ignore[attr-defined]
    if app.builder.format != "html":
        return
    if reason := missing():
        print(f"No live pages: {reason}.")
        return
    folder = Path(app.srcdir).parent / "build" / "docs" / "live_pages"
    app.env.flexhinf_live = make(folder)  # type: ignore[attr-defined]
    app.config.html_extra_path = [*app.config.html_extra_path, str(folder)]


def read_source(app: Sphinx, name: str, source: list[str]) -> None:
    """Handler of ``source-read``."""
    if name in ("index", "live"):
        source[0] = source[0].replace(_PLACE, text(app.env.flexhinf_live, name))  # type: ignore[attr-defined]


def setup(app: Sphinx) -> None:
    """Register all of this file."""
    app.connect("builder-inited", begin)
    app.connect("source-read", read_source)
