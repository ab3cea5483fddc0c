"""A tab without its page: controls, files, and the numbers of `flexhinf design`."""

from __future__ import annotations

import asyncio
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.designs import read_request
from flexhinf.designs.specification import FIELDS
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.studio.controls import (
    CONTROLS,
    TOLERANCES,
    Control,
    advice_text,
    changed,
    current_text,
    current_value,
)
from flexhinf.studio.folder import WorkingFolder
from flexhinf.studio.preview import Band, LinearParts, Nominal, stages
from flexhinf.studio.server import OwnPages
from flexhinf.studio.session import Session, opened
from flexhinf.studio.tiles import tiles_of
from flexhinf.studio.worker import Ticket

BY_KEY = {control.key: control for control in CONTROLS}

# Loops that run eight times at most: 1.5 s instead of 2.0 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return Session(WorkingFolder(tmp_path), opened())


def computed(session: Session) -> tuple[Nominal, Band, LinearParts]:
    parts = list(stages(session.robot, replace(session.specification, draws=8)))
    for part in parts:
        session.keep(part)
    nominal, band, linear = parts
    assert isinstance(nominal, Nominal)
    assert isinstance(band, Band)
    assert isinstance(linear, LinearParts)
    return nominal, band, linear


def test_every_control_is_a_field_with_help() -> None:
    assert len({control.key for control in CONTROLS}) == len(CONTROLS)
    for control in CONTROLS:
        assert control.help
        if control.has_slider:
            for place in (0, control.steps // 3, control.steps):
                assert abs(control.position(float(control.text(place))) - place) <= 1


@pytest.mark.parametrize("control", [each for each in CONTROLS if each.has_slider], ids=lambda each: each.key)
def test_a_slider_changes_its_field_and_shows_it(session: Session, control: Control) -> None:
    before, text = session.specification, control.text(control.steps // 4)
    session.change(control, text)
    shown = current_text(control, session.specification, session.tolerances, session.robot.links.slides)
    value = current_value(control, session.specification, session.tolerances, session.robot)
    assert float(shown) == pytest.approx(float(text), rel=1e-3)
    assert control.position(value) == pytest.approx(control.steps // 4, abs=1)
    assert session.tolerances != 1.0 if control.key == TOLERANCES else session.specification != before
    session.change(control, "")
    default = 1.0 if control.key == TOLERANCES else fh.Specification().__getattribute__(control.field)
    now = session.tolerances if control.key == TOLERANCES else getattr(session.specification, control.field)
    assert now == default


def test_a_goal_in_degrees_is_shown_as_it_is_read() -> None:
    """Of a joint that slides, too: 0.1 m was shown as 5.72958deg."""
    goal = FIELDS["pose"].read("90deg,0.1m")
    stated = fh.Specification(pose=goal, angle_unit="deg")
    assert current_text(BY_KEY["pose"], stated, 1.0, (False, True)) == "90deg,0.1m"


def test_weights_and_behaviour_give_way_to_each_other(session: Session) -> None:
    session.change(BY_KEY["penalty.link_position"], "80")
    assert session.specification.penalty == {"link_position": 80.0, "link_position_integral": 300.0}
    session.change(BY_KEY["bandwidth"], "4")
    assert session.specification.penalty is None
    assert session.specification.bandwidth == 4.0
    session.change(BY_KEY["effort"], "2")
    assert session.specification.bandwidth is None


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("gamma_ratio", "0.5"), ("gamma_ratio", "nan"), ("gamma_ratio", "1e400"), ("gamma_ratio", "five"),
        ("degrees", "13"), ("damping", "2"), ("measurement_noise", "-1"), ("pose", "5mm"), ("pose", "x" * 5000),
        ("unknown_delay", "0.3ms"), ("draws", "1e9"), ("draws", "2000000"), (TOLERANCES, "nan"), (TOLERANCES, "-1"),
        (TOLERANCES, "1e9"), ("penalty.link_position", "nan"), ("estimator", "magic"), ("duration", "1e9"),
    ],
)  # fmt: skip
def test_a_value_that_cannot_be_used_changes_nothing(session: Session, key: str, text: str) -> None:
    before, tolerances = session.specification, session.tolerances
    with pytest.raises(FlexhinfError) as caught:
        session.change(BY_KEY[key], text)
    assert caught.value.what
    assert caught.value.found
    assert caught.value.advice
    assert (session.specification, session.tolerances) == (before, tolerances)


HOSTILE = {
    "no table": "x = 1\n",
    "no robot": "[design]\npose = 1.0\n",
    "not a number": '[design]\nrobot = "paper"\npose = nan\n',
    "a huge number": '[design]\nrobot = "paper"\ndraws = 999999999999999999999999\n',
    "a wrong type": "[design]\nrobot = 3\n",
    "a wrong type of a field": '[design]\nrobot = "paper"\nperiod = [1, 2]\n',
    "an unknown field": '[design]\nrobot = "paper"\ncommand_line = "rm"\n',
    "deep nesting": '[design]\nrobot = "paper"\npenalty = ' + "[" * 5000 + "]" * 5000 + "\n",
    "deep keys": "a" + ".a" * 5000 + " = 1\n",
    "megabytes": '[design]\nrobot = "paper"\n' + "# padding\n" * 1_000_000,
    "a long list": '[design]\nrobot = "paper"\npose = [' + "1.0," * 20_000 + "]\n",
    "bytes": "\ufffd\x00\x01",
    "half a file": '[design]\nrobot = "pap',
    "a missing robot": '[design]\nrobot = "arm.toml"\n',
}


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_a_hostile_file_is_refused_and_changes_nothing(session: Session, text: str) -> None:
    (session.folder.root / "design.toml").write_text(text, encoding="utf-8")
    before = session.request
    with pytest.raises(InvalidInput) as caught:
        session.load("design.toml")
    assert caught.value.what
    assert caught.value.found
    assert caught.value.advice
    assert len(str(caught.value)) < 4000
    assert session.request is before


@pytest.mark.ci("a design that is made again")
def test_what_is_saved_gives_the_same_numbers_when_it_is_loaded(session: Session) -> None:
    for key, text in {"gamma_ratio": "1.8", "penalty.link_position": "90", "torque_noise": "3e-7"}.items():
        session.change(BY_KEY[key], text)
    session.change(BY_KEY[TOLERANCES], "1.5")
    first, band, _ = computed(session)
    assert session.save("tuned.toml").count("tuned") == 2
    other = Session(session.folder, opened("planar-two-link"))
    other.load("tuned.toml")
    assert other.specification == session.specification
    assert other.robot.parameters[0].tolerance == session.robot.parameters[0].tolerance
    second, same, _ = computed(other)
    assert np.array_equal(first.step.positions, second.step.positions)
    assert band.samples is not None
    assert same.samples is not None
    assert np.array_equal(band.samples.positions, same.samples.positions, equal_nan=True)


def test_other_files_are_not_replaced(session: Session) -> None:
    (session.folder.root / "arm.toml").write_text('name = "mine"\n', encoding="utf-8")
    with refused_with(InvalidInput, "arm.toml"):
        session.save("arm.toml")
    for name in ("design.json", "none/design.toml", "../design.toml"):
        with pytest.raises(InvalidInput):
            session.save(name)
    assert (session.folder.root / "arm.toml").read_text(encoding="utf-8") == 'name = "mine"\n'
    assert "design.toml" in session.save("design.toml")
    assert "design.toml" in session.save("design.toml")


def test_a_run_of_the_band_is_made_again_bit_by_bit(session: Session) -> None:
    _, band, _ = computed(session)
    assert band.samples is not None
    k = band.samples.worst
    run = band.run(k)
    rows = np.rint(band.samples.time / session.specification.period).astype(int)
    assert np.array_equal(run.positions[rows], band.samples.positions[k])
    instant = len(rows) // 3
    at, position = band.samples.time[instant], float(band.samples.positions[5, instant, 0])
    assert band.nearest(0, at, position) == 5


def test_tiles_have_the_worst_of_the_sampled_robots() -> None:
    class Samples:
        settling, overshoot, peak = np.array([[1.0, 2.5], [4.0, 3.0], [8.0, 9.0]])
        diverged = unsettled = 0

        def __len__(self) -> int:
            return 2

    step = SimpleNamespace(
        settling=SimpleNamespace(value=0.9), overshoot=SimpleNamespace(value=0.5), peak_input=7.0
    )
    setup = SimpleNamespace(limits=SimpleNamespace(effort_units=("V",)))
    nominal: Any = SimpleNamespace(requirements=(), step=step, setup=setup)
    found = tiles_of(nominal, SimpleNamespace(requirements=(), samples=Samples()), None)  # type: ignore[arg-type]
    for key, own, worst in (("settling", "0.9", "2.5"), ("overshoot", "0.5", "4"), ("peak", "7", "9")):
        assert found[key].number.startswith(own)
        assert f"2 {worst}\N{NO-BREAK SPACE}" in found[key].beside


@pytest.mark.ci("makes a whole design")
def test_the_numbers_are_those_of_the_design(session: Session) -> None:
    session.change(BY_KEY["draws"], "8")
    nominal, band, linear = stages(session.robot, session.specification)
    session.save("design.toml")
    request = read_request(session.folder.root / "design.toml")
    robot, s = request.robot, request.specification
    result = fh.design(robot, replace(s, proof_seconds=0.0))
    assert isinstance(nominal, Nominal)
    assert isinstance(band, Band)
    assert isinstance(linear, LinearParts)
    assert np.array_equal(result.evidence.evaluation.step.positions, nominal.step.positions)
    assert band.samples is not None
    assert np.array_equal(result.evidence.evaluation.step_samples.overshoot, band.samples.overshoot)
    assert (
        result.evidence.evaluation.margins.peak_sensitivity
        == linear.nominal.evaluation.margins.peak_sensitivity
    )
    lines = {(line.what, line.where): line for line in result.requirements}
    for line in (*nominal.requirements, *linear.requirements):
        if line.what != "damping of oscillations":  # that of the design names its joint
            assert lines[line.what, line.where].found == line.found


@pytest.mark.ci("exports C and FMU twice")
def test_exports_are_written_under_free_names(session: Session) -> None:
    computed(session)
    for kind, first in (("c", "paper-c"), ("fmu", "paper.fmu")):
        for _ in range(2):
            notes = list(session.exported(kind)(Ticket(lambda ticket: iter(()), lambda result: None)))
            assert notes[-1].done
        assert (session.folder.root / first).exists()
    assert (session.folder.root / "paper-c-2" / "paper.c").is_file()
    assert (session.folder.root / "paper-2.fmu").is_file()


def test_a_design_for_a_workspace_becomes_one_of_a_pose() -> None:
    request = opened("planar-two-link")
    assert request.specification.pose == request.robot.home
    assert request.specification.degrees == (2,)
    assert request.specification.torque_noise


def test_a_text_without_a_unit_is_in_radians(session: Session) -> None:
    s = changed(session.specification, BY_KEY["pose"], "1.2", session.robot)
    assert s.pose == (1.2,)


@pytest.mark.parametrize(
    ("advice", "text"),
    [
        ("bandwidth=1.4e+02. The arm vibrates", "Bandwidth 140. The arm vibrates"),
        ("start=(0.2, -0.4), or [0, 1]", "Start 0.2,-0.4, or 0,1"),
        ("45deg in commands and specifications, np.deg2rad(45) elsewhere; or another", "45deg; or another"),
        ("measured=('link_position', 'motor_position')", "Measured link_position,motor_position"),
    ],
)
def test_an_advice_is_what_the_field_takes(advice: str, text: str) -> None:
    assert advice_text(InvalidInput("", "", advice)) == text


@pytest.mark.parametrize("control", CONTROLS, ids=lambda control: control.key)
def test_no_advice_is_in_python(session: Session, control: Control) -> None:
    advice = ""
    for text in ("abc", "7m/s", "[1"):
        try:
            session.change(control, text)
        except FlexhinfError as error:
            advice += advice_text(error)
    assert set("=()[]'") & set(advice) == set()


def asked(app: Any, kind: str, headers: dict[str, str], query: str = "") -> list[dict[str, Any]]:
    """What an application sends as the answer to one request."""
    sent: list[dict[str, Any]] = []

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    pairs = [(name.encode(), value.encode()) for name, value in headers.items()]
    asyncio.run(app({"type": kind, "headers": pairs, "query_string": query.encode()}, None, send))
    return sent


@pytest.mark.parametrize(
    ("frame", "is_own"),
    [
        *(
            ({"text": text}, True)
            for text in ("3", "2probe", "40", "41", '421["handshake",{"a":[1]}]', '42["event",{}]')
        ),
        *(
            ({"text": text}, False)
            for text in ("", "7", "42[]", '42["event",5]', "42[1,{}]", "42[", "43", "4")
        ),
        ({"bytes": b"\xff\x00"}, False),
    ],
)
def test_a_frame_that_no_page_sends_ends_the_socket(frame: dict[str, Any], is_own: bool) -> None:
    """Tasks of the library would stumble over it, each with a traceback."""
    got: list[dict[str, Any]] = []

    async def page(scope: Any, receive: Any, send: Any) -> None:
        got.append(await receive())

    async def receive() -> dict[str, Any]:
        return {"type": "websocket.receive", **frame}

    app, host = OwnPages(page, "secret"), "127.0.0.1:8080"
    headers = {b"host": host.encode(), b"cookie": b"flexhinf-studio-8080=secret"}
    scope = {"type": "websocket", "headers": list(headers.items()), "query_string": b""}
    asyncio.run(app(scope, receive, None))
    assert got[0]["type"] == ("websocket.receive" if is_own else "websocket.disconnect")


def test_the_studio_answers_who_has_its_secret() -> None:
    """Every user of the computer reaches the port."""
    seen: list[str] = []

    async def page(scope: Any, receive: Any, send: Any) -> None:
        seen.append(scope["type"])
        if scope["type"] == "websocket":
            raise ValueError("a frame that is no message")

    app, here = OwnPages(page, "secret"), {"host": "127.0.0.1:8080"}
    assert asked(app, "http", here)[0]["status"] == 403
    assert asked(app, "http", here, "token=wrong")[0]["status"] == 403
    assert asked(app, "websocket", here)[0]["type"] == "websocket.close"
    assert seen == []
    moved = asked(app, "http", here, "token=secret")[0]
    assert moved["status"] == 303
    cookie = dict(moved["headers"])[b"set-cookie"].decode().partition(";")[0]
    known = {**here, "cookie": f"another=1; {cookie}"}
    asked(app, "http", known)
    assert asked(app, "websocket", known)[0]["type"] == "websocket.close"  # and no traceback
    assert seen == ["http", "websocket"]
    elsewhere = {**known, "origin": "http://example.org"}
    assert asked(app, "http", elsewhere)[0]["status"] == 403
    assert (
        asked(app, "http", {**known, "host": "localhost:9090"})[0]["status"] == 403
    )  # another studio's cookie


def test_every_button_of_the_page_asks_for_an_export_that_there_is(session: Session) -> None:
    page = (Path(fh.__file__).parent / "studio" / "page.py").read_text(encoding="utf-8")
    kinds = re.findall(r'self\.export\("(\w+)"\)', page)
    assert len(kinds) == 3
    for kind in kinds:
        session.exported(kind)
    with refused_with(InvalidInput, "export", "page", "report"):
        session.exported("page")
