"""Pictures of the guides, taken from what the commands beside them write.

A guide begins with a picture between markers of docs/make.py. The first block of code after it makes the picture: it
runs in a folder with the files that the page shows. Tests run the same blocks as they are printed.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from html import unescape
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[1]
DOCS, IMAGES = ROOT / "docs", ROOT / "docs" / "images"

_BLOCK = re.compile(r"^```(sh|python|toml|csv|xml|text)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_FILE = re.compile(r"^(?:#|<!--) file: (\S+)")


@dataclass(frozen=True)
class Picture:
    """A picture of a guide.

    Attributes
    ----------
    says : str
        What it shows, for those who do not see it.
    draw : function
        Takes the folder in which the block has run, and the names that it defined where it is Python; returns SVG, or
        the bytes of a PNG.
    """

    says: str
    draw: Callable[[Path, dict[str, Any]], str | bytes]


def figure(file: str, name: str) -> Callable[[Path, dict[str, Any]], str]:
    """The drawing ``figure-NAME`` of a page that the block writes, light, on white; its film moves over and over."""

    def draw(folder: Path, names: dict[str, Any]) -> str:
        page = (folder / file).read_text(encoding="utf-8")
        found = re.search(
            rf'<figure id="figure-{name}"(?: data-film="([^"]*)")?>.*?(<svg.*?)</svg>', page, re.DOTALL
        )
        if found is None:
            others = ", ".join(re.findall(r'<figure id="figure-([^"]+)', page))
            raise SystemExit(f"{file}: no figure {name!r}; it has {others}")
        if not found[1]:
            return alone(f"{found[2]}</svg>")
        faint = re.sub(r'(<g id="[^"]*-pose-[^"]*")', r'\1 opacity="0.25"', found[2])
        return alone(f"{faint}{moving(json.loads(unescape(found[1])))}</svg>")

    return draw


def moving(film: dict[str, Any]) -> str:
    """The lines of a `report.Film` as SVG that moves by itself, as slowly as on the page, and rests for a second."""
    seconds = film["seconds"]
    whole = seconds[-1] - seconds[0]
    slower = max(1.0, 2.0 / whole)
    lasts = slower * whole + 1.0
    instants = ";".join(f"{slower * (t - seconds[0]) / lasts:.4f}" for t in seconds) + ";1"
    styles = {
        1: "stroke:var(--series-1);stroke-width:4",
        2: "stroke:var(--series-2);stroke-width:2;stroke-dasharray:6 3",
    }
    lines = []
    for series, points in film["lines"]:
        texts = [" ".join(map(str, each)) for each in (*points, points[-1])]
        lines.append(
            f'<polyline points="{texts[-1]}" '
            f'style="fill:none;stroke-linecap:round;stroke-linejoin:round;{styles[series]}">'
            f'<animate attributeName="points" values="{";".join(texts)}" keyTimes="{instants}" dur="{lasts:.3g}s" '
            'repeatCount="indefinite"/></polyline>'
        )
    return "".join(lines)


def alone(svg: str) -> str:
    """A drawing of a page as a file of its own, on white."""
    from flexhinf.report.figure import standalone

    opened, rest = standalone(svg).split(">", 1)
    return f'{opened}><rect width="100%" height="100%" fill="white"/>{rest}\n'


# Pictures that no page has ---------------------------------------------------------------------------------
def run_of(folder: Path, names: dict[str, Any]) -> str:
    """The run of the program: what is tracked, or all states, and the inputs."""
    return on_white(names["run"].plot())


def on_white(drawing: Any) -> str:
    """A figure of Matplotlib as SVG, on white."""
    from flexhinf.report import figure_to_svg

    drawing.set_facecolor("white")
    return figure_to_svg(drawing)


def tracked(folder: Path, names: dict[str, Any]) -> str:
    """The true path, the estimates, and the beacon of the program of the Kalman filters."""
    import numpy as np

    from flexhinf.report import INK, SERIES, house_style, label, legend, panels

    with house_style():
        drawing, ((axes,),) = panels(1, 1, 4.2)
        truth, found = np.array(names["truth"]), names["data"]["smoothed"].values
        axes.plot(*truth[:, :2].T, color=SERIES[0], linewidth=3.0, alpha=0.4, label="truth")
        axes.plot(*found[:, :2].T, color=SERIES[1], dashes=(4.0, 2.0), label="estimate, smoothed")
        axes.plot(2.0, 3.0, "^", color=INK, label="beacon")
        axes.set(aspect="equal", xlabel="px (m)")
        label(axes, "py", "m")
        legend(axes)
    return on_white(drawing)


def wired(into: list[str], box: list[str], out: list[str]) -> str:
    """A box with what comes in above it and what goes out below it, as SVG whose letters a telephone can show."""
    from flexhinf.report import INK, SERIES

    line, top = 22, 22 * len(into) + 48
    below = top + line * len(box) + 20
    high = below + 48 + line * len(out)
    texts = [(18 + line * k, entry, "") for k, entry in enumerate(into)]
    texts += [(top + 24 + line * k, entry, "" if k else ' font-weight="bold"') for k, entry in enumerate(box)]
    texts += [(below + 56 + line * k, entry, "") for k, entry in enumerate(out)]
    arrows = [
        f'<path d="M 240 {y} v 26" stroke="{colour}" stroke-width="2"/><path d="M 240 {y + 36} l -6 -11 h 12 z"/>'
        for y, colour in ((top - 38, SERIES[0]), (below + 2, SERIES[1]))
    ]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 480 {high}" font-family="sans-serif" '
            f'font-size="16" fill="{INK}" text-anchor="middle">',
            f'<rect width="480" height="{high}" fill="white"/>',
            f'<rect x="110" y="{top}" width="260" height="{below - top}" rx="8" fill="none" stroke="{INK}"/>',
            *arrows,
            *(f'<text x="240" y="{y}"{bold}>{entry}</text>' for y, entry, bold in texts),
            "</svg>",
            "",
        ]
    )


def exported(folder: Path, names: dict[str, Any]) -> str:
    """What the exported C takes and gives at each step, of the settings that the export wrote."""
    settings = _settings(folder)
    inputs = [f"{name}, {_unit(name)}" for name in settings["measurements"]]
    outputs = [f"{name}, {_unit(name)}" for name in settings["inputs"]]
    period = f"every {1e3 * settings['period']:g} ms"
    return wired(
        [*inputs, "command, rad"], ["my_arm.c", "my_arm_step", period], [*outputs, "estimate", "status"]
    )


def in_ros(folder: Path, names: dict[str, Any]) -> str:
    """Interfaces and topics of the plugin, of the settings that the export wrote."""
    settings = _settings(folder)
    return wired(
        [
            *(entry["interface"] for entry in settings["measurements"].values()),
            "~/follow_joint_trajectory",
            "~/command",
        ],
        ["my_arm_controller", "plugin of ros2_control", f"{1.0 / settings['period']:g} Hz"],
        [*(entry["interface"] for entry in settings["inputs"].values()), "~/state"],
    )


def _settings(folder: Path) -> dict[str, Any]:
    text = (folder / "firmware/ros2/config/my_arm_controller.yaml").read_text(encoding="utf-8")
    found: dict[str, Any] = yaml.safe_load(text)["my_arm_controller"]["ros__parameters"]
    return found


def _unit(name: str) -> str:
    return "V" if "voltage" in name else "N·m" if "torque" in name else "rad"


def studio(folder: Path, names: dict[str, Any]) -> bytes:
    """The page of the studio, in Chromium."""
    from shutil import which

    from playwright.sync_api import sync_playwright

    command = [sys.executable, "-m", "flexhinf", "studio", "planar-two-link", "--no-browser"]
    with subprocess.Popen(
        command, cwd=folder, env=environment(), stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline().split()[1]
            with sync_playwright() as api:
                started = api.chromium.launch(executable_path=which("chromium"), args=["--no-sandbox"])
                page = started.new_page(viewport={"width": 1100, "height": 800})
                page.goto(address)
                page.wait_for_function("!document.body.innerText.includes('…')", polling=200, timeout=240_000)
                picture: bytes = page.screenshot()
                started.close()
        finally:
            process.terminate()
            process.wait(20)
    return picture


# Pages -----------------------------------------------------------------------------------------------------
#: Of every guide but the notebook, whose cells draw, and docs/design.md, whose picture docs/readme_step.py makes.
PICTURES: dict[str, Picture] = {
    "robots": Picture(
        "Two links at home; arrows say where each joint moves them", figure("checked/index.html", "robot")
    ),
    "studio": Picture("Sliders beside the step, the poles and the arm of two links", studio),
    "moves": Picture(
        "Two links along waypoints, and how far they are from them", figure("run/index.html", "result")
    ),
    "comparison": Picture(
        "The arm under both laws in the worst move", figure("flexhinf-compare/index.html", "arms")
    ),
    "campaigns": Picture(
        "The arm of the worst of 2000 robots beside the median one", figure("campaign/index.html", "arms")
    ),
    "logs": Picture(
        "Measured and estimated signals over time", figure("flexhinf-estimate/index.html", "measured")
    ),
    "identify": Picture(
        "Measured signals beside those of the numbers that were identified",
        figure("flexhinf-identify/index.html", "measured"),
    ),
    "certificate": Picture(
        "Region that is proved about the goal", figure("flexhinf-certificate/index.html", "starts")
    ),
    "deployment": Picture("What comes into a step of the exported C, and what goes out", exported),
    "ros2": Picture("Interfaces, topics and action of the plugin", in_ros),
    "realtime": Picture("Step in MuJoCo, link and voltage over time", figure("run/index.html", "result")),
    "supervision": Picture(
        "A load pushes the link at 2 s, and a protective stop follows", figure("run/index.html", "result")
    ),
    "estimators": Picture("True and estimated path about a beacon", tracked),
    "guides/own_plant": Picture("Cart and pendulum come to rest", run_of),
}


def environment() -> dict[str, str]:
    """Of a command: this source, and the programs beside this Python."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    return {**os.environ, "PYTHONPATH": str(ROOT / "src"), "PATH": path}


def begins(page: str) -> tuple[str, str]:
    """Language and text of the first block after the picture of a guide."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    found = _BLOCK.search(text, text.index("<!-- made: picture"))
    assert found is not None, page
    return found[1], found[2]


def made(page: str) -> tuple[Path, str | bytes, str]:
    """File and content of the picture of a guide, and the line that shows it."""
    picture, (language, block) = PICTURES[page], begins(page)
    with tempfile.TemporaryDirectory() as name:
        folder, names = Path(name), {}
        for _, text in _BLOCK.findall((DOCS / f"{page}.md").read_text(encoding="utf-8")):
            if file := _FILE.match(text):
                (folder / file[1]).write_text(text, encoding="utf-8")
        if language == "python":
            exec(compile(block, page, "exec"), names)
        elif language == "sh":
            outcome = subprocess.run(
                ["bash", "-c", block],
                cwd=folder,
                env=environment(),
                capture_output=True,
                text=True,
                check=False,
            )
            if outcome.returncode not in (0, 1):
                raise SystemExit(f"{page}: {outcome.stderr}")
        content = picture.draw(folder, names)
    ending = "png" if isinstance(content, bytes) else "svg"
    stem = page.rpartition("/")[2]
    place = IMAGES / f"guide_{stem}.{ending}"
    return place, content, f"![{picture.says}]({'../' * page.count('/')}images/{place.name})"
