"""Pages of every kind in Chromium: screens of a design, the first screen, letters, accessibility, and pictures of them.

With ``FLEXHINF_SCREENSHOTS=folder`` the pictures are kept there: each page at three widths, light and dark.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests import store
from tests.browser import WINDOWS, keep, opened, serious, sheets
from tests.report.test_browser import LEGIBLE, LETTERS, UNFOLD

import flexhinf as fh
from flexhinf.cli import main
from flexhinf.designs import Specification
from flexhinf.pages import certificate_page, write_report

# Designs are made once here, or by a test of a command: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

#: Screens of 1280 by 800 px that a design's page has at most as it opens, its folds closed.
SCREENS = 8

#: Designs as `flexhinf design` makes them, of one pose and of a workspace: robot and specification.
DESIGNS: dict[str, tuple[str, dict[str, Any]]] = {
    "workspace": ("paper", {}),
    "two links": ("planar-two-link", {"pose": [0.6, 0.4], "draws": 2, "degrees": (2,)}),
    "no length": ("quanser-rotflex", {"pose": [1.0], "draws": 20}),
}

#: Pages that the commands write into a folder, by kind.
COMMANDS = {
    "design": "design paper --pose 90deg",
    "run": "run flexhinf-design --mujoco --no-realtime --duration 2s --out run",
    "checked robot": "check planar-two-link --out checked_robot",
    "checked log": "check run/run.csv --robot paper --out checked_log",
    "estimate": "estimate run/run.csv --robot flexhinf-design --out estimate",
    "identify": "identify run/run.csv --robot paper --parameters stiffness,friction --out identify",
    "campaign": "campaign flexhinf-design --samples 40 --out campaign",
    "pair": "campaign compare flexhinf-design flexhinf-design --samples 20 --out pair",
    "paper": "paper --out paper",
    "small workspace": "design paper --workspace 0:0.02 --estimator none --draws 0 --out small_workspace",
    "workspace comparison": "compare small_workspace --laws pd-gravity --out workspace_comparison",
    "workspace campaign": "campaign small_workspace --samples 5 --out workspace_campaign",
    "workspace proof": "certify small_workspace --out workspace_proof",
}
#: A design that docs/design.md makes too, as it is made there.
OF_DOCS = {
    "workspace of two links": "design planar-two-link --measured link_position,motor_position",
}
#: What a page is made of, where that is another page's design or log.
MADE_OF = {
    **dict.fromkeys(("run", "campaign", "pair"), "design"),
    **dict.fromkeys(("estimate", "identify", "checked log"), "run"),
    **dict.fromkeys(("workspace comparison", "workspace campaign", "workspace proof"), "small workspace"),
}
KINDS = (
    *(kind for kind in COMMANDS if kind != "small workspace"),
    "comparison",
    "certificate",
    "workspace",
    *OF_DOCS,
)

#: Pages that take long, of which others of their kind are cheap.
DEAR = {
    "workspace": pytest.mark.nightly("the workspace of one link; that of two links has its parts"),
    "paper": pytest.mark.nightly("the page of a whole reproduction"),
}


def cases(names: Iterable[str]) -> list[Any]:
    each = pytest.mark.ci("a browser, and a command that writes a page")
    return [pytest.param(name, marks=DEAR.get(name, each)) for name in names]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pages")


@pytest.fixture(scope="module")
def page_of(folder: Path, request: pytest.FixtureRequest) -> Any:
    """The file of a page by its kind, made when it is first asked for."""

    def of(kind: str) -> Path:
        place = folder / kind.replace(" ", "_")
        if kind in ("design", *OF_DOCS):
            place = (folder if kind == "design" else place) / "flexhinf-design"
        path = place / "index.html"
        if path.exists():
            return path
        if kind == "comparison":
            request.getfixturevalue("report_comparison").save(path.parent)
        elif kind in OF_DOCS:
            place.parent.mkdir()
            with pytest.MonkeyPatch.context() as patch:
                patch.setenv("COLUMNS", store.COLUMNS)
                patch.delenv("FLEXHINF_OPTIMISATION")
                assert store.command(OF_DOCS[kind].split(), place.parent).code in (0, 1)
        elif kind == "design":
            assert store.command(COMMANDS[kind].split(), folder).code in (0, 1)
        elif kind in DESIGNS:
            robot, fields = DESIGNS[kind]
            write_report(fh.design(fh.load_robot(robot), Specification(**fields)), path.parent)
        elif kind == "certificate":
            path.parent.mkdir()
            proved_degree, evidence = map(request.getfixturevalue, ("proved_degree", "evidence"))
            page = certificate_page(
                (proved_degree,),
                proved_degree,
                evidence,
                Specification(pose=(np.pi,)),
                ["flexhinf", "certify"],
            )
            path.write_text(page.html(), encoding="utf-8")
        else:
            if kind in MADE_OF:
                of(MADE_OF[kind])
            with pytest.MonkeyPatch.context() as patch:
                patch.chdir(folder)
                assert main(COMMANDS[kind].split()) in (0, 1)
        return path

    return of


@pytest.mark.parametrize("name", cases(["design", *DESIGNS, *OF_DOCS]))
def test_a_page_of_a_design_is_eight_screens_at_most(browser: Any, page_of: Any, name: str) -> None:
    with opened(browser, page_of(name)) as page:
        height, window = page.evaluate("[document.documentElement.scrollHeight, innerHeight]")
        print(f"{name}: {height / window:.1f} screens")
        assert height / window <= SCREENS
        arm = ["#figure-result-arm svg"] * (name != "no length")
        for part in (".verdict", ".numbers", "#figure-result svg", *arm):
            box = page.locator(part).bounding_box()
            assert box["y"] + box["height"] <= window, f"{part} is not on the first screen"
        folded = page.locator("main details:not([open])").count()
        assert folded > 2


@pytest.mark.parametrize("kind", cases(KINDS))
def test_pages_have_no_serious_problem_and_legible_letters(browser: Any, page_of: Any, kind: str) -> None:
    """Problems are looked for in the narrowest window, light, and in the widest, dark. Paper takes one sheet."""
    with opened(browser, page_of(kind), min(WINDOWS)) as page:
        for width, height in WINDOWS.items():
            page.set_viewport_size({"width": width, "height": height})
            for scheme in ("light", "dark"):
                page.emulate_media(color_scheme=scheme)
                keep(page, f"{kind}-{width}-{scheme}")
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            if width == 1280:
                assert sheets(page) == 1
        page.evaluate(UNFOLD)
        for width, height in WINDOWS.items():
            page.set_viewport_size({"width": width, "height": height})
            if width != 1280:
                page.emulate_media(color_scheme="light" if width < 1280 else "dark")
                assert serious(page) == []
            assert min([LEGIBLE, *page.evaluate(LETTERS)]) >= LEGIBLE
