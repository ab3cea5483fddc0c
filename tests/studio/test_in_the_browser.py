"""Chromium drives the studio: every slider, text and button is used, and its effect on the page is looked at."""

from __future__ import annotations

import re
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from tests.browser import keep, serious
from tests.refusals import unnamed

from flexhinf.studio.controls import CONTROLS

pytestmark = [
    pytest.mark.ci("a browser, and a design for each change"),
    pytest.mark.skipif(find_spec("nicegui") is None, reason="missing: nicegui"),
]

#: Milliseconds after which a page is taken to hang, on however busy a machine.
PATIENCE = 120_000

#: A window in which nothing moves by itself.
STILL = {"viewport": {"width": 1280, "height": 900}, "reduced_motion": "reduce"}

#: Opens a tab on the paper's arm and waits for its first design.
Open = Callable[..., Any]

#: The latest revision of which the page has drawn everything.
LATEST = (
    """Math.max(0, ...(window.studioDrawn || []).filter((d) => d.part === 'linear').map((d) => d.revision))"""
)

#: The figures, as they are drawn: each by its title.
PICTURES = """() => Object.fromEntries([...document.querySelectorAll('.studio-figure')].map((figure) => [
  figure.querySelector('.studio-figure-title').textContent, figure.querySelector('canvas').toDataURL()]))"""

#: Ends when the page was drawn twice, and so in its new size.
DRAWN = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"

#: Whether a field has a text.
VALUE = """([key, text]) => document.querySelector(`input[data-testid='${key}']`).value === text"""

#: Whether so many runs were replayed, as the notes say.
REPLAYS = """(count) => {
  const notes = document.querySelector("[data-testid='notes']").innerText;
  return (notes.match(/Replayed/g) || []).length === count;
}"""

#: What a slider changes: figures by their title, tiles by their key.
CHANGES = {
    "gamma_ratio": ("Step", "Input", "Poles", "peak"),
    "penalty.link_position": ("Step", "Input", "Poles", "settling"),
    "penalty.link_position_integral": ("Step", "Input", "Poles"),
    "penalty.link_velocity": ("Step", "Input"),
    "effort": ("Step", "Input", "Poles", "peak"),
    "bandwidth": ("Step", "Input", "Poles", "peak"),
    "damping": ("Step", "Input", "Poles"),
    "torque_noise": ("Estimation error", "Sensitivity at the inputs"),
    "measurement_noise": ("Estimation error", "Sensitivity at the inputs"),
    "unknown_delay": ("Step",),
    "tolerances": ("Step", "overshoot"),
    "draws": ("Step", "unstable"),
    "saturation": ("Input",),
}


@contextmanager
def studio(folder: Path, *arguments: str) -> Iterator[str]:
    """The address of a studio at a free port, which ends with the test."""
    command = [sys.executable, "-m", "flexhinf", "studio", *arguments, "--no-browser"]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().split()[1]
        finally:
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("studio")


@pytest.fixture(scope="module")
def address(browser: Any, folder: Path) -> Iterator[str]:
    with studio(folder) as found:
        yield found


#: Keeps every text that is drawn on a canvas.
HEARD = """window.drawnTexts = [];
const draw = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (text, ...place) {
  window.drawnTexts.push(text);
  return draw.call(this, text, ...place);
};"""


def test_a_figure_without_numbers_says_so_and_makes_none_up(browser: Any, address: str) -> None:
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    context.add_init_script(HEARD)
    page = context.new_page()
    page.set_default_timeout(PATIENCE)
    page.goto(address)
    page.wait_for_function("window.drawnTexts.length >= 5")
    first = page.evaluate("window.drawnTexts.slice(0, 5)")
    assert page.get_by_role("progressbar").count() == 1
    context.close()
    assert [text for text in first if re.search(r"\d", text)] == []


@contextmanager
def tabs(browser: Any, address: str) -> Iterator[Open]:
    """Tabs whose scripts must not fail. Their arm stands until it is played: Chromium would draw it all the time."""
    contexts, troubles = [], []

    def open_tab(where: str = "", **options: Any) -> Any:
        contexts.append(browser.new_context(**{**STILL, **options}))
        page = contexts[-1].new_page()
        page.set_default_timeout(PATIENCE)
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.on("console", lambda line: troubles.append(line.text) if line.type == "error" else None)
        page.goto(where or address)
        settled(page, 0)
        return page

    yield open_tab
    for context in contexts:
        context.close()
    assert troubles == []


@pytest.fixture
def opened(browser: Any, address: str) -> Iterator[Open]:
    with tabs(browser, address) as open_tab:
        yield open_tab


@pytest.fixture(scope="module")
def tab(browser: Any, address: str) -> Iterator[Any]:
    """One tab for all tests that leave its design as it was."""
    with tabs(browser, address) as open_tab:
        yield open_tab()


def settled(page: Any, last: int) -> None:
    """Wait until a later revision than `last` is drawn whole."""
    page.wait_for_function(
        f"(last) => {LATEST} > last && !document.body.innerText.includes('computing')",
        arg=last,
        polling=100,  # ms; at every frame the page would do little else
    )


@contextmanager
def anew(page: Any) -> Iterator[None]:
    """What is done inside asks for a design, which is awaited."""
    last = page.evaluate(LATEST)
    yield
    settled(page, last)


def part(page: Any, key: str) -> Any:
    return page.locator(f"[data-testid='{key}']")


def says(page: Any, key: str, text: str) -> None:
    """Wait until a part of the page contains a text."""
    page.wait_for_function(
        "([key, text]) => document.querySelector(`[data-testid='${key}']`).innerText.includes(text)",
        arg=[key, text],
    )


def looks(page: Any) -> dict[str, str]:
    """All figures and tiles."""
    tiles = page.locator(".studio-tile")
    texts = {tile.get_attribute("data-testid")[5:]: tile.inner_text() for tile in tiles.all()}
    return {**page.evaluate(PICTURES), **texts}


def write(page: Any, key: str, text: str) -> None:
    part(page, key).fill(text)
    part(page, key).press("Enter")


def test_every_slider_is_tried() -> None:
    assert set(CHANGES) == {control.key for control in CONTROLS if control.has_slider}


def test_every_slider_changes_the_design(opened: Open) -> None:
    """One after the other; at the end each is emptied, which brings back its default."""
    page = opened()
    texts = {key: part(page, key).input_value() for key in CHANGES}
    for key, changes in CHANGES.items():
        before = looks(page)
        with anew(page):
            slider = part(page, f"{key}-slider")
            if key == "penalty.link_velocity":  # which weighs little at first
                slider.click(position={"x": 200, "y": 12})
            else:
                slider.locator("[tabindex]").first.press("ArrowLeft" if key == "saturation" else "ArrowRight")
        after = looks(page)
        assert part(page, key).input_value() not in ("", texts[key]), key
        assert [name for name in changes if after[name] == before[name]] == [], key
        assert part(page, "errors").inner_text() == "", key
        if key in ("bandwidth", "damping"):  # for which weights are searched
            with anew(page):
                write(page, key, "")
            assert part(page, key).input_value() == texts[key]
    for key in reversed([key for key in CHANGES if not key.startswith("penalty")]):
        write(page, key, "")
        page.wait_for_function(VALUE, arg=[key, "" if key == "torque_noise" else texts[key]])
        if key == "torque_noise":  # for which "" asks for a search
            write(page, key, texts[key])


TEXTS = {
    "pose": ("45deg", ("Step", "Input")),
    "start": ("30deg", ("Step", "Input")),
    "duration": ("2", ("Step", "Input", "Estimation error")),
    "measured": ("motor_position", ("Estimation error", "Sensitivity at the inputs")),
    "seed": ("7", ("Step", "Estimation error")),
}

CHOICES = {
    "degrees-6": ("Step", "Input"),
    "degrees-2": ("Step", "Input"),
    "estimator-ekf": (),  # whose error differs by less than a pixel
    "estimator-observer": ("Estimation error",),
    "estimator-none": ("Estimation error", "Sensitivity at the inputs"),
    "degrees-auto": (),  # which may choose the same
}


@pytest.mark.parametrize("kind", ["texts", "choices"])
def test_texts_and_choices_change_the_design(opened: Open, kind: str) -> None:
    """One after the other."""
    page = opened()
    for key, changes in CHOICES.items() if kind == "choices" else ((k, c) for k, (_, c) in TEXTS.items()):
        before = looks(page)
        with anew(page):
            if kind == "texts":
                write(page, key, TEXTS[key][0])
            else:
                part(page, key).click()
        after = looks(page)
        assert kind == "texts" or part(page, key).get_attribute("aria-pressed") == "true", key
        assert [name for name in changes if after[name] == before[name]] == [], key
        assert part(page, "errors").inner_text() == "", key


def test_runs_are_replayed(tab: Any) -> None:
    """By button, and by a click into the band."""
    page = tab
    before = looks(page)["Step"]
    part(page, "pick-largest").click()
    says(page, "notes", "Replayed: robot")
    assert looks(page)["Step"] != before
    part(page, "pick-nominal").click()
    says(page, "notes", "Replayed: nominal")
    part(page, "pick-slowest").click()
    page.wait_for_function(REPLAYS, arg=3)
    page.locator(".studio-step canvas").click(position={"x": 150, "y": 90})
    page.wait_for_function(REPLAYS, arg=4)


def test_the_arm_is_played_turned_and_magnified(opened: Open) -> None:
    page = opened()
    arm = page.locator(".studio-arm")
    assert arm.get_by_role("button").inner_text() == "Play"
    time = arm.get_by_label("Time of the replay")
    clock = arm.locator(".studio-clock").inner_text()
    time.focus()
    for name in ("Home", *["PageUp"] * 2):
        page.keyboard.press(name)
    shown = looks(page)["Arm"]
    assert arm.locator(".studio-clock").inner_text() != clock
    arm.get_by_label("Magnification of the wind-up").fill("5")
    magnified = looks(page)["Arm"]
    assert magnified != shown
    box = arm.locator("canvas").bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 180, box["y"] + 130, steps=4)
    page.mouse.up()
    assert looks(page)["Arm"] != magnified
    arm.get_by_role("button").click()
    stood = arm.locator(".studio-clock").inner_text()
    page.wait_for_function("(old) => document.querySelector('.studio-clock').innerText !== old", arg=stood)
    assert arm.get_by_role("button").inner_text() == "Pause"


def test_another_state(tab: Any) -> None:
    page = tab
    before = looks(page)["Estimation error"]
    assert part(page, "state-link_position").get_attribute("aria-pressed") == "true"
    part(page, "state-motor_velocity").click()
    page.wait_for_function(f"(old) => ({PICTURES})()['Estimation error'] !== old", arg=before)
    assert part(page, "state-link_position").get_attribute("aria-pressed") == "false"
    assert part(page, "state-motor_velocity").get_attribute("aria-pressed") == "true"


def test_light_and_dark(tab: Any) -> None:
    page = tab
    ground = "getComputedStyle(document.body).backgroundColor"
    first = page.evaluate(ground)
    part(page, "light").click()
    page.wait_for_function(f"(old) => {ground} !== old", arg=first)
    part(page, "light").click()
    page.wait_for_function(f"(old) => {ground} === old", arg=first)


def test_two_tabs_do_not_disturb_each_other(opened: Open) -> None:
    page, other = opened(), opened()
    before = looks(other)
    with anew(page):
        write(page, "gamma_ratio", "3")
    assert part(other, "gamma_ratio").input_value() == "1.5"
    with anew(other):
        write(other, "seed", "0.")  # refused, so nothing changes
        write(other, "duration", "4.0")
    after = looks(other)
    assert {
        name: after[name] == before[name] for name in ("Step", "Input", "Poles", "peak")
    } == dict.fromkeys(("Step", "Input", "Poles", "peak"), True)
    assert looks(page)["peak"] != after["peak"]


def test_a_refused_text_changes_nothing(tab: Any) -> None:
    page = tab
    before = looks(page)["Step"]
    write(page, "gamma_ratio", "0.5")
    says(page, "errors", "try:")
    assert unnamed(part(page, "errors").inner_text(), "found:", "expected", 0.5) == []
    assert looks(page)["Step"] == before
    assert page.locator(".studio-outdated").count() == 2  # tiles and figures of other settings are grey
    with anew(page):
        write(page, "gamma_ratio", "1.5")  # what it was
    assert part(page, "errors").inner_text() == ""
    assert page.locator(".studio-outdated").count() == 0


def test_save_and_load(opened: Open, folder: Path) -> None:
    page, other = opened(), opened()
    with anew(page):
        write(page, "gamma_ratio", "2.25")
    with anew(page):
        write(page, "tolerances", "1.5")
    write(page, "file", "saved.toml")
    part(page, "save").click()
    says(page, "said", str(folder))  # at the top, where the button is
    says(page, "notes", "Saved saved.toml")
    assert "2.25" in (folder / "saved.toml").read_text(encoding="utf-8")
    write(other, "file", "saved.toml")
    with anew(other):
        part(other, "load").click()
    assert part(other, "gamma_ratio").input_value() == "2.25"
    assert looks(other)["overshoot"] == looks(page)["overshoot"]


HOSTILE = {
    "broken": ('[design]\nrobot = "', ("broken.toml",)),
    "elsewhere": ('[design]\nrobot = "/etc/passwd"\n', ("robot", "/etc/passwd")),
    "climbing": ('[design]\nrobot = "../../secret.toml"\n', ("robot", "../../secret.toml")),
    "code": ('[design]\nrobot = "paper"\npenalty = "__import__(\'os\')"\n', ("penalty",)),
    "script": ('[design]\nrobot = "<img src=x onerror=alert(1)>"\n', ("<img src=x onerror=alert(1)>",)),
    "unknown": ('[design]\nrobot = "paper"\ngamma = 3\n', ("gamma",)),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused(tab: Any, folder: Path, name: str) -> None:
    text, names = HOSTILE[name]
    (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    page, before = tab, looks(tab)["Step"]
    write(page, "file", f"{name}.toml")
    part(page, "load").click()
    for own in names:  # the last one is in no other file's
        says(page, "errors", own)
    assert unnamed(part(page, "errors").inner_text(), "found:", "expected") == []
    assert part(page, "errors").locator("img").count() == 0
    assert looks(page)["Step"] == before


@pytest.mark.parametrize(
    ("act", "name"),
    [("load", "../secret.toml"), ("load", "/etc/passwd"), ("load", "nothing.toml"), ("save", "../secret.toml"),
     ("save", "/etc/passwd")],
)  # fmt: skip
def test_a_name_outside_of_the_folder_is_refused(tab: Any, folder: Path, act: str, name: str) -> None:
    page = tab
    write(page, "file", name)
    part(page, act).click()
    says(page, "errors", name)  # which is not that of the test before
    assert unnamed(part(page, "errors").inner_text(), "expected", "got") == []
    assert not (folder.parent / "secret.toml").exists()


def test_exports(opened: Open, folder: Path) -> None:
    page = opened()
    part(page, "c").click()
    says(page, "notes", "C in paper-c")
    assert (folder / "paper-c" / "paper.c").is_file()
    part(page, "fmu").click()
    says(page, "notes", "FMU: paper.fmu")
    assert (folder / "paper.fmu").is_file()
    part(page, "report").click()
    says(page, "notes", "Report: flexhinf-design")
    assert (folder / "flexhinf-design" / "index.html").is_file()


@pytest.mark.parametrize(
    "headers",
    [{"Host": "evil.example:80"}, {"Origin": "http://evil.example"}, {"Host": "127.0.0.1.evil.example:80"}],
)
def test_another_site_is_turned_away(address: str, headers: dict[str, str]) -> None:
    request = urllib.request.Request(address, headers=headers)
    with pytest.raises(urllib.error.HTTPError) as caught:
        urllib.request.urlopen(request, timeout=20)
    with caught.value:
        assert caught.value.code == 403


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_is_accessible(tab: Any, scheme: str) -> None:
    page = tab
    page.emulate_media(color_scheme=scheme)
    assert serious(page) == []
    write(page, "gamma_ratio", "0.5" if scheme == "light" else "0.25")
    says(page, "errors", "0.5" if scheme == "light" else "0.25")
    assert serious(page) == []


@pytest.mark.parametrize("robot", ["paper", "planar-two-link"])
def test_it_fits_a_window(opened: Open, tmp_path: Path, robot: str) -> None:
    """And a robot of two joints shows each of them; its arm moves."""
    with studio(tmp_path, robot) as where:
        page = opened(where, reduced_motion="no-preference")
        assert page.locator(".studio-arm").get_by_role("button").inner_text() == "Pause"  # it moves by itself
        if robot != "paper":
            before = looks(page)["Step"]
            part(page, "joint-1").click()
            page.wait_for_function(f"(old) => ({PICTURES})()['Step'] !== old", arg=before)
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            for width in (390, 1280, 1920):
                page.set_viewport_size({"width": width, "height": 900})
                page.evaluate(DRAWN)
                keep(page, f"studio-{robot}-{scheme}-{width}", full_page=True)
                assert page.evaluate("document.documentElement.scrollWidth") <= width
        page.close()  # before its server ends
