"""Chromium drives the page: every control is moved, and its effect on the arms is looked at."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.browser import WINDOWS, keep, serious
from tests.export.web.conftest import moving_live_arm, paper_live_arm

import flexhinf.export.web as web
from flexhinf.export.web import write_page

pytestmark = pytest.mark.ci("Chromium")

#: Opens the page of a robot, with options of Chromium's context.
Open = Callable[..., Any]


@pytest.fixture(scope="module")
def pages(webassembly_compiler: None, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("pages")
    arms = {
        "paper": paper_live_arm(),
        "two": moving_live_arm("planar-two-link"),
        "spatial": moving_live_arm("spatial-three-link"),
    }
    return {name: write_page(arm, folder / f"{name}.html") for name, arm in arms.items()}


@pytest.fixture
def opened(browser: Any, pages: dict[str, Path]) -> Iterator[Open]:
    """Pages that must neither fail nor ask for anything but themselves."""
    contexts, troubles = [], []

    def open_page(name: str, **options: Any) -> Any:
        context = browser.new_context(**{"viewport": {"width": 1280, "height": 800}, **options})
        contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.on("console", lambda line: troubles.append(line.text) if line.type == "error" else None)
        page.on("request", lambda request: None if request.url.startswith(("file:", "data:", "blob:"))
                else troubles.append(request.url))  # fmt: skip
        page.clock.install(time=0)  # tests say how time goes on
        page.clock.pause_at(1.0)
        page.goto(pages[name].as_uri())
        page.wait_for_function("window.livePage !== undefined", polling=20)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert troubles == []


def slide(page: Any, key: str, value: float) -> None:
    """Move a slider as a hand does."""
    page.evaluate(
        """([key, value]) => { const slider = document.getElementById(`slider-${key}`);
        slider.value = String(value); slider.dispatchEvent(new Event("input", { bubbles: true })); }""",
        [key, value],
    )


def until(page: Any, condition: str, seconds: float = 20.0) -> None:
    """Let the page's time go on until the condition holds."""
    for _ in range(round(10.0 * seconds)):
        if page.evaluate(condition):
            return
        page.clock.run_for(100)
    assert page.evaluate(condition), condition


def now(page: Any) -> float:
    return page.evaluate("livePage.simulation.time")


def number(page: Any, name: str, arm: int = 0) -> float:
    """A number of one of the arms."""
    return page.evaluate(
        "([arm, name]) => livePage.simulation.numbers[arm][livePage.s.numbers.indexOf(name)]", [arm, name]
    )


def test_it_runs_pauses_and_begins_again(opened: Open) -> None:
    page = opened("paper")
    until(page, "livePage.simulation.time > 0.5")
    page.click("#pause")
    paused = now(page)
    page.clock.run_for(300)
    assert now(page) == paused
    assert page.inner_text("#pause") == "Start"
    page.keyboard.press("Tab")
    page.locator("body").press("Space")  # a button in focus would be pressed twice
    page.locator("#ours").press("Space")
    until(page, f"livePage.simulation.time > {paused} + 0.2")
    page.click("#reset")
    assert now(page) < paused
    page.locator("#ours").press("r")
    assert now(page) < 0.5


def test_half_the_speed(opened: Open) -> None:
    """Of simulated time per time of the page's clock."""
    page = opened("paper")
    page.select_option("#speed", "0.1")
    begun = page.evaluate("[performance.now(), livePage.simulation.time]")
    page.clock.run_for(2000)
    ended = page.evaluate("[performance.now(), livePage.simulation.time]")
    assert (ended[1] - begun[1]) / (ended[0] - begun[0]) * 1e3 == pytest.approx(0.1, rel=0.05)


def test_the_goal_moves_by_slider_click_and_keys(opened: Open) -> None:
    page = opened("paper")
    slide(page, "goal-0", 45.0)
    assert page.evaluate("livePage.goal[0]") == pytest.approx(math.pi / 4.0, abs=1e-3)
    assert not page.is_checked("#wander")
    until(page, "Math.abs(livePage.simulation.states[0][0] - Math.PI / 4) < 0.03")
    until(page, "document.getElementById('ours-status').textContent === 'at the goal'")
    box = page.locator("#ours").bounding_box()
    x, y = page.evaluate("livePage.view.point(livePage.view.tipOf(livePage.simulation.frames([1.1])))")
    page.mouse.click(box["x"] + x, box["y"] + y)
    assert page.evaluate("livePage.goal[0]") == pytest.approx(1.1, abs=0.15)
    before = page.evaluate("livePage.goal[0]")
    page.locator("#ours").press("ArrowRight")
    assert page.evaluate("livePage.goal[0]") == pytest.approx(before + math.radians(5.0), abs=1e-9)


def test_a_pulled_link_gives_way_and_comes_back(opened: Open) -> None:
    """The hand's torque acts on both arms, the spring winds up, the motor works against it."""
    page = opened("paper")
    page.uncheck("#wander")
    page.clock.run_for(300)
    rest = page.evaluate("livePage.simulation.states[0][0]")
    box = page.locator("#ours").bounding_box()
    middle = (
        "livePage.view.tipOf(livePage.simulation.frames([0])).map((v) => 0.5 * v)"  # of the link, which hangs
    )
    x, y = page.evaluate(f"livePage.view.point({middle})")
    page.mouse.move(box["x"] + x, box["y"] + y)
    page.mouse.down()
    page.mouse.move(box["x"] + x + 0.4 * box["width"], box["y"] + 0.1 * box["height"], steps=8)
    until(page, f"livePage.simulation.states[0][0] > {rest} + 0.02")
    pulled = page.evaluate(
        "(({ simulation: sim }) => ({ torque: sim.view(sim.code.torque_at(), 1)[0], windup: sim.windup(0, 0), "
        "input: sim.inputs[0][0], other: sim.states[1][0] }))(livePage)"
    )
    assert pulled["torque"] > 0.5
    assert pulled["windup"] < 0.0
    assert pulled["input"] < 0.0
    assert pulled["other"] > 0.005
    page.mouse.up()
    until(page, "livePage.simulation.view(livePage.simulation.code.torque_at(), 1)[0] === 0")
    until(page, "Math.abs(livePage.simulation.states[0][0]) < 0.03")


def test_a_push_without_a_mouse(opened: Open) -> None:
    page = opened("two")
    page.uncheck("#wander")
    page.click("#push")
    until(page, "livePage.simulation.view(livePage.simulation.code.torque_at(), 2)[0] > 0")
    until(page, "livePage.simulation.view(livePage.simulation.code.torque_at(), 2)[0] === 0")
    page.locator("#ours").press("ArrowDown")
    assert page.input_value("#joint") == "1"
    page.locator("#ours").press("p")
    until(page, "livePage.simulation.view(livePage.simulation.code.torque_at(), 2)[1] > 0")


def test_every_number_of_the_arm_has_a_slider_that_acts(opened: Open) -> None:
    """On both arms at once, and back to nominal."""
    page = opened("paper")
    rows = page.evaluate("livePage.s.sliders")
    assert len(rows) == 11
    for row in rows:
        slide(page, row["name"], 2.0)
        wanted = row["value"] + 2.0 * (row["upper"] - row["value"])
        assert number(page, row["name"]) == number(page, row["name"], 1) == pytest.approx(wanted)
    assert page.locator("#tolerances output", has_text="tolerance").count() == len(rows)
    stiffness = page.evaluate(
        "Array.from(livePage.simulation.view(livePage.simulation.code.parameters_at(0), 11))"
    )
    page.click("#nominal")
    for row in rows:
        assert number(page, row["name"]) == pytest.approx(row["value"])
    assert stiffness != page.evaluate(
        "Array.from(livePage.simulation.view(livePage.simulation.code.parameters_at(0), 11))"
    )


def test_a_payload_makes_the_arm_sag(opened: Open) -> None:
    page = opened("paper")
    slide(page, "goal-0", 90.0)
    until(page, "[0, 1].every((arm) => Math.abs(livePage.simulation.states[arm][0] - Math.PI / 2) < 0.02)")
    before = math.pi / 2.0 - 0.02
    slide(page, "payload_mass", 0.3)
    assert number(page, "payload_mass") == 0.3
    until(page, f"livePage.simulation.states[1][0] < {before} - 0.01")  # a PD without an integral stays below


def test_noise_and_latency(opened: Open) -> None:
    page = opened("paper")
    page.uncheck("#wander")
    spread = """() => {
      const u = [];
      livePage.history.each("oursInput", livePage.simulation.time - 0.5, (t, v) => u.push(v));
      const mean = u.reduce((a, b) => a + b, 0) / u.length;
      return Math.sqrt(u.reduce((a, b) => a + (b - mean) ** 2, 0) / u.length);
    }"""
    slide(page, "noise", 0.0)
    page.clock.run_for(1500)
    quiet = page.evaluate(spread)
    slide(page, "noise", 30.0)
    page.clock.run_for(1500)
    assert page.evaluate(spread) > 3.0 * quiet + 1e-6
    slide(page, "latency", 12)
    assert page.evaluate("livePage.simulation.latency") == 12
    assert "12 samples (12 ms)" in page.inner_text("#conditions")


def test_without_sensors_it_predicts_then_holds(opened: Open) -> None:
    page = opened("paper")
    until(page, "livePage.simulation.time > 0.1")  # the first sample is measured
    page.check("#sensor")
    until(page, "document.getElementById('ours-status').textContent.includes('held')")
    assert "held" in page.inner_text("#rival-status")
    page.uncheck("#sensor")
    until(page, "!document.getElementById('ours-status').textContent.includes('held')")


def test_perturbed_arms(opened: Open) -> None:
    """Fifty at a click, others by another seed, the same by the same."""
    page = opened("paper")
    stiffness = "livePage.simulation.numbers.map((v) => v[livePage.s.numbers.indexOf('stiffness')])"
    page.check("#ghosts")
    assert page.evaluate("livePage.simulation.pairs") == 50
    first = page.evaluate(stiffness)
    assert len(set(first)) == 51
    page.fill("#seed", "7")
    page.locator("#seed").press("Enter")
    other = page.evaluate(stiffness)
    assert other != first
    page.fill("#seed", "1")
    page.locator("#seed").press("Enter")
    assert page.evaluate(stiffness) == first
    slide(page, "spread", 3.0)
    assert max(page.evaluate(stiffness)) - 100.0 == pytest.approx(3.0 * (max(first) - 100.0))
    slide(page, "count", 12)
    assert page.evaluate("livePage.simulation.pairs") == 12
    until(page, "Math.abs(livePage.simulation.states[2][0] - livePage.simulation.states[4][0]) > 1e-4")
    page.uncheck("#ghosts")
    assert page.evaluate("livePage.simulation.pairs") == 0


def test_it_keeps_up_with_the_clock(opened: Open) -> None:
    """With fifty arms of one link, and with fewer, as the page says, where an arm takes long to compute."""
    page = opened("paper")
    page.check("#ghosts")
    begun = now(page)
    page.clock.run_for(3000)
    assert now(page) - begun == pytest.approx(3.0, abs=0.1)
    assert page.evaluate("livePage.simulation.pairs") == 50
    page.evaluate("""() => {
      const sim = livePage.simulation, plain = performance.now.bind(performance), advance = sim.advance.bind(sim);
      let spent = 0;
      performance.now = () => plain() + spent;
      sim.advance = (samples) => { advance(samples); spent += 0.02 * samples * sim.pairs; };
    }""")
    page.clock.run_for(3000)
    shown = page.evaluate("livePage.simulation.pairs")
    assert 0 < shown < 50
    assert f"{shown} are shown" in page.inner_text("#ghost-note")
    begun = now(page)
    page.clock.run_for(2000)
    assert now(page) - begun == pytest.approx(2.0, abs=0.1)


def test_the_pd_beside_it(opened: Open) -> None:
    page = opened("paper")
    assert page.is_visible("#theirs")
    page.uncheck("#rival")
    assert not page.is_visible("#theirs")
    slide(page, "goal-0", 20.0)
    page.clock.run_for(800)
    page.check("#rival")
    page.clock.run_for(200)
    assert abs(page.evaluate("livePage.simulation.states[1][0] - livePage.simulation.states[0][0]")) < 0.2
    top = """(text) => { document.querySelector("#ours-status").textContent = text;
        return document.querySelector("#ours").getBoundingClientRect().top; }"""
    longest = re.search(
        r'return "(an input or [^"]+)"', Path(web.__file__).with_name("page.js").read_text(encoding="utf-8")
    )
    assert longest
    for width in (390, 1280, 1920):
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate(top, longest[1]) == page.evaluate(top, "off")
    tops = page.evaluate("""() => {
        document.querySelector("#rival-status").textContent = "a status that is long enough to wrap ".repeat(3);
        return ["#ours", "#theirs"].map((name) => document.querySelector(name).getBoundingClientRect().top);
    }""")
    assert tops[0] == pytest.approx(tops[1], abs=0.1)
    page.click("#about summary")
    assert "encoders" in page.inner_text("#about")


def test_the_first_move_shows_the_difference(opened: Open) -> None:
    """It is fast, beside the stiff PD, whose links then swing (test_live_arm); smooth moves have the tuned PD."""
    page = opened("two")
    until(page, "livePage.simulation.time > 0.6")
    assert page.evaluate("livePage.simulation.stiff")
    assert page.evaluate("livePage.goal.every((q, j) => q === livePage.s.goal[j])")
    until(page, "livePage.simulation.time > 0.6 + livePage.s.fast")
    assert page.evaluate("livePage.simulation.command()") == pytest.approx(page.evaluate("livePage.s.goal"))
    note = page.inner_text("#rival-note")
    page.uncheck("#rival")
    page.uncheck("#wander")
    page.select_option("#moves", "smooth")
    assert page.is_checked("#wander")
    assert page.is_visible("#theirs")
    assert page.evaluate("livePage.simulation.stiff") is False
    assert page.inner_text("#rival-note") != note
    until(page, "livePage.goal.every((q, j) => q === livePage.s.other[j])")
    page.select_option("#moves", "fast")
    until(page, "livePage.goal.every((q, j) => q === livePage.s.goal[j])")
    page.click("#reset")
    assert page.evaluate("livePage.simulation.stiff") is True


def test_joints_are_chosen_and_moved_together_or_alone(opened: Open) -> None:
    page = opened("two")
    page.select_option("#joint", "1")
    assert page.evaluate("livePage.joint") == 1
    nominal = number(page, "stiffness_elbow")
    slide(page, "all-stiffness", -1.0)
    assert number(page, "stiffness_elbow") < nominal
    assert number(page, "stiffness_shoulder") < page.evaluate(
        "livePage.s.nominal[livePage.s.numbers.indexOf('stiffness_shoulder')]"
    )
    slide(page, "stiffness_elbow", 0.0)
    assert number(page, "stiffness_elbow") == pytest.approx(nominal)


def test_a_spatial_arm_turns_and_is_aimed(opened: Open) -> None:
    page = opened("spatial")
    page.uncheck("#wander")
    before = page.evaluate("[livePage.view.azimuth, livePage.goal]")
    box = page.locator("#ours").bounding_box()
    x, y = box["x"] + 0.1 * box["width"], box["y"] + 0.1 * box["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 80, y + 30, steps=4)
    page.mouse.up()
    assert page.evaluate("livePage.view.azimuth") == pytest.approx(before[0] + 0.8)
    assert page.evaluate("livePage.goal") == before[1]
    page.mouse.click(box["x"] + 0.8 * box["width"], box["y"] + 0.4 * box["height"])
    assert page.evaluate("livePage.goal") != before[1]
    tip = page.evaluate("livePage.view.point(livePage.view.tipOf(livePage.simulation.frames(livePage.goal)))")
    assert math.hypot(tip[0] - 0.8 * box["width"], tip[1] - 0.4 * box["height"]) < 12.0


def test_nobody_who_asks_for_rest_is_moved(opened: Open) -> None:
    page = opened("paper", reduced_motion="reduce")
    page.clock.run_for(500)
    assert now(page) == 0.0
    assert "–" not in page.inner_text("#position-name")  # numbers from the first frame on
    page.click("#pause")
    until(page, "livePage.simulation.time > 0.3")


@pytest.mark.parametrize("width", WINDOWS)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_everybody_can_use_it(width: int, scheme: str, opened: Open) -> None:
    """Axe finds nothing serious, nothing is wider than the screen."""
    page = opened("two", viewport={"width": width, "height": WINDOWS[width]}, color_scheme=scheme)
    page.clock.run_for(1200)
    page.clock.resume()  # axe and the picture wait for the page
    keep(page, f"live-{width}-{scheme}")
    page.evaluate("document.querySelectorAll('details').forEach((part) => (part.open = true))")
    assert serious(page) == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
