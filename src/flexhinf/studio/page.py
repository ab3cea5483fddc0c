"""The page of one tab: rows of controls, tiles, figures, the arm, files. All of it runs on the event loop."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from nicegui import Client, core, ui
from numpy.typing import ArrayLike

from flexhinf.designs.pipeline import stages
from flexhinf.designs.responses import Response
from flexhinf.errors import FlexhinfError
from flexhinf.numerals import number, number_text
from flexhinf.pages.drawing import display_scale
from flexhinf.progress import Steps, time_left
from flexhinf.studio import controls, drawing
from flexhinf.studio.controls import CONTROLS, Control
from flexhinf.studio.elements import ArmView, ControlRow, LiveFigure, mark_chosen, plain_button
from flexhinf.studio.preview import Band, LinearParts, Nominal
from flexhinf.studio.session import FileNote, Replay, Session
from flexhinf.studio.tiles import TILES, Tile, tiles_of
from flexhinf.studio.worker import Begun, Worker


class StudioPage:
    """One tab."""

    def __init__(self, session: Session, previews: Worker, files: Worker) -> None:
        self.session, self.previews, self.files = session, previews, files
        self.client: Client = ui.context.client
        assert core.loop is not None, "the page is built on the event loop"
        self.loop = core.loop
        self.joint, self.state, self.revision, self.requested_at = 0, "", 0, 0.0
        self.steps, self.doing, self.begun = Steps(()), "", (0.0, 0.0)  # share and time of the present step
        self.took = 0.0  # by the last change until all was shown, s
        self.seconds: dict[str, float] = {}
        self._build()
        self._show_controls()
        self._joints_of()
        self.client.on_delete(self._forget)  # pyright: ignore[reportUnknownMemberType]  # NiceGUI leaves it open
        for text in (*session.request.notes, *session.request.warnings):
            self._note(text)
        ui.timer(0.05, self.compute, once=True)

    def _forget(self) -> None:
        for worker in (self.previews, self.files):
            worker.drop(self)
            worker.drop((self, "replay"))

    # Building -----------------------------------------------------------------------------------------
    def _build(self) -> None:
        self.dark = ui.dark_mode(None)
        with ui.element("div").classes("studio"):
            with ui.element("div").classes("studio-head"):
                ui.html("<h1>flexhinf studio</h1>", sanitize=False)
                self.name = ui.label().classes("studio-name")
                self._file_bar()
            with ui.element("div").classes("studio-controls").props('role=region aria-label="Settings"'):
                self.rows = [row for group in controls.GROUPS for row in self._group(group)]
            with ui.element("div").classes("studio-main"):
                self.errors = ui.element("div").classes("studio-alert").props("role=alert data-testid=errors")
                self.said = ui.label().classes("studio-said").props("role=status data-testid=said")
                self.said.visible = False
                self.tiles = self._tiles()
                with ui.element("div").classes("studio-bar"):
                    self._run_bar()
                with ui.element("div").classes("studio-figures") as self.figures:
                    self._figures()
                self.notes = ui.element("div").classes("studio-noted").props("role=log data-testid=notes")

    def _file_bar(self) -> None:
        with ui.element("div").classes("studio-files").props('role=group aria-label="Files"'):
            names = self.session.folder.designs()
            self.file = ui.input(value="design.toml", autocomplete=names)
            self.file.props('dense outlined aria-label="Design file in the working folder" data-testid=file')
            for label, act in (
                ("Load", self.load),
                ("Save", self.save),
                ("C", lambda: self.export("c")),
                ("FMU", lambda: self.export("fmu")),
                ("Report", lambda: self.export("report")),
                ("Light / dark", self.theme),
            ):
                button = plain_button(label, act).props(f'data-testid="{label.split()[0].lower()}"')
                if label in ("C", "FMU", "Report"):
                    button.props(f'aria-label="Export {label}"')

    def _group(self, group: str) -> Iterator[ControlRow]:
        ui.html(f"<h2>{group}</h2>", sanitize=False)
        for control in CONTROLS:
            if control.group == group:
                yield ControlRow(control, self.change)

    def _tiles(self) -> dict[str, tuple[ui.element, ui.label, ui.label]]:
        found: dict[str, tuple[ui.element, ui.label, ui.label]] = {}
        with ui.element("div").classes("studio-tiles") as self.tile_bar:
            for key, label in TILES.items():
                wide = " wide" if key == "verdict" else ""
                with ui.element("dl").classes(f"studio-tile{wide}").props(f"data-testid=tile-{key}") as tile:
                    with ui.element("dt"):
                        ui.label(label)
                    with ui.element("dd"):
                        number = ui.label("…").classes("studio-number")
                        beside = ui.label().classes("studio-beside")
                found[key] = tile, number, beside
        return found

    def _run_bar(self) -> None:
        with ui.element("div").props('role=group aria-label="Run that is replayed"').classes("studio-files"):
            ui.label("Replay")
            replays: dict[str, Callable[[Band], int]] = {
                "Nominal": lambda band: -1,
                "Largest overshoot": lambda band: -1 if band.samples is None else band.samples.worst,
                "Slowest": lambda band: -1 if band.samples is None else band.samples.slowest,
            }
            for label, choose in replays.items():
                button = plain_button(label, partial(self.pick, choose))
                button.props(f'data-testid="pick-{label.split()[0].lower()}"')
        self.joints = ui.element("div").props('role=group aria-label="Joint"').classes("studio-files")
        self.states = (
            ui.element("div").props('role=group aria-label="Estimated state"').classes("studio-files")
        )
        self.status = ui.label().classes("studio-status").props("data-testid=status")
        self.bar = ui.linear_progress(0.0, show_value=False).props(
            'aria-label="Share of the work that is done"'
        )
        ui.timer(1.0, self._tell)

    def _figures(self) -> None:
        self.arm = ArmView("Arm")
        self.step = LiveFigure("Step", "time, s", pickable=True).classes("studio-step")
        self.step.on("pick", self._clicked)
        self.effort = LiveFigure("Input", "time, s")
        self.error = LiveFigure("Estimation error", "time, s")
        self.sensitivity = LiveFigure("Sensitivity at the inputs", "frequency, rad/s", logx=True, logy=True)
        self.poles = LiveFigure("Poles", "real part, 1/s")

    def _joints_of(self) -> None:
        """Buttons for the joints of the robot, and the first one that moves."""
        names = self.session.robot.joint_names
        self.joint = 0
        self.joints.clear()
        self.joint_buttons: list[ui.button] = []
        with self.joints:
            if len(names) > 1:
                ui.label("Joint")
            for k, name in enumerate(names if len(names) > 1 else ()):
                button = plain_button(name, lambda k=k: self.choose_joint(k)).props(f"data-testid=joint-{k}")
                mark_chosen(button, k == self.joint)
                self.joint_buttons.append(button)
        self.name.text = (
            f"{self.session.robot.name}, {len(names)} joint{'s' * (len(names) > 1)}: "
            "a design for one goal, not for all poses"
        )

    # What the user does ---------------------------------------------------------------------------------
    def change(self, control: Control, text: str) -> None:
        """Take a value of a control and compute again."""
        with self._refusals():
            try:
                self.session.change(control, text)
            except FlexhinfError:
                next(row for row in self.rows if row.control is control).refused()
                self._outdated(True)
                raise
            self._show_controls()
            self.compute()

    async def theme(self) -> None:
        """Dark where the page is light, and light where it is dark."""
        self.dark.value = not await ui.run_javascript("document.body.classList.contains('body--dark')")

    def choose_joint(self, k: int) -> None:
        """Show the curves of another joint."""
        self.joint, self.state = k, ""
        for each, button in enumerate(self.joint_buttons):
            mark_chosen(button, each == k)
        self._redraw()

    def choose_state(self, name: str) -> None:
        """Show the estimation error of another state."""
        self.state = name
        if self.session.nominal is not None:
            self._show_error(self.session.nominal)

    def load(self) -> None:
        """Take the design of the named file."""
        with self._refusals():
            self.session.load(self.file.value)
            self._joints_of()
            self._show_controls()
            for text in (*self.session.request.notes, *self.session.request.warnings):
                self._note(text)
            self._say(f"Loaded {self.file.value}.")
            self.compute()

    def save(self) -> None:
        """Write the design under the named file."""
        with self._refusals():
            self._say(self.session.save(self.file.value))
            self.file.set_autocomplete(self.session.folder.designs())

    def export(self, kind: str) -> None:
        """Write C, an FMU or a report beside the preview."""
        with self._refusals():
            self.files.submit(self, self.session.exported(kind), self._deliver)

    def pick(self, choose: Callable[[Band], int]) -> None:
        """Replay a run of the band."""
        band = self.session.band
        if band is None:
            return
        k = choose(band) if band.samples is not None else -1
        self.previews.submit((self, "replay"), self.session.replay(k), self._deliver)

    def _clicked(self, event: Any) -> None:
        nominal, place = self.session.nominal, dict[str, Any]()
        if isinstance(event.args, dict):
            place |= event.args  # pyright: ignore[reportUnknownMemberType]  # as the browser sends it
        if (
            self.session.band is None
            or nominal is None
            or not all(_is_finite(place.get(name)) for name in "xy")
        ):
            return
        at, position = place["x"], place["y"] / drawing.Scales(nominal, self.joint).factor
        self.pick(lambda band: band.nearest(self.joint, at, position))

    @contextmanager
    def _refusals(self) -> Generator[None]:
        """Show an error in three parts; without one, clear the last."""
        try:
            yield
        except FlexhinfError as error:
            self._refuse(error)
        else:
            self.errors.clear()

    def _refuse(self, error: FlexhinfError) -> None:
        self.errors.clear()
        with self.errors, ui.element("div").classes("studio-error"):
            for head, text in (
                ("", error.what),
                ("found: ", error.found),
                ("try: ", controls.advice_text(error)),
            ):
                if text:
                    with ui.element("p"), ui.element("strong" if not head else "span"):
                        ui.label(head + text)

    def _say(self, text: str) -> None:
        """A note about files, also at the top, where the buttons are; with the folder that they are in."""
        self._note(text)
        self.said.text, self.said.visible = f"{text} Folder: {self.session.folder.root}", True

    def _outdated(self, outdated: bool) -> None:
        """Show whether tiles and figures belong to other settings than those that stand on the page."""
        for element in (self.tile_bar, self.figures):
            element.classes(**{"add" if outdated else "remove": "studio-outdated"})

    def _note(self, text: str) -> None:
        with self.notes:
            ui.label(text)
        for old in list(self.notes)[:-6]:
            old.delete()

    # Computing ---------------------------------------------------------------------------------------------
    def compute(self) -> None:
        """Ask for the design as it is now; an earlier request that is under way is dropped."""
        self.revision += 1
        self.requested_at = time.perf_counter()
        self.steps, self.doing, self.begun = self._steps(), "", (0.0, 0.0)
        self.bar.visible, self.bar.value = True, 0.0
        self._tell()
        revision = self.revision
        self.previews.submit(self, self.session.preview, lambda result: self._deliver(result, revision))

    def _steps(self) -> Steps:
        """The work steps of the design as it is asked for; none where it cannot be designed, which the worker says."""
        with suppress(FlexhinfError):
            return Steps(stages(self.session.robot, self.session.specification))
        return Steps(())

    def _tell(self) -> None:
        """Say what is computed and how long it will take, as long as something is."""
        if self.bar.visible:
            now, (share, at) = time.perf_counter() - self.requested_at, self.begun
            left = time_left(share, at, now)
            doing, expected = self.doing and f": {self.doing}", f", {left}" if left else self._usual()
            self.status.text = f"computing{doing}{expected} …"

    def _usual(self) -> str:
        """How long the last change took, as long as the present one will take."""
        return f", about {max(self.took, 0.1):.2g} s as the last one" if self.took else ""

    def _deliver(self, result: object, revision: int = 0) -> None:
        with suppress(RuntimeError):  # the server has ended
            self.loop.call_soon_threadsafe(self._show, result, revision)

    def _show(self, result: object, revision: int) -> None:
        """Show a result of a worker, unless a later request is under way."""
        if self.client.id not in Client.instances:
            return
        with self.client:
            if isinstance(result, FileNote):
                self._say(result.text)
            elif isinstance(result, Begun):
                if revision == self.revision:
                    share = self.steps.begin(result.text) / max(self.steps.total, 1e-9)
                    self.doing, self.begun = result.text, (share, time.perf_counter() - self.requested_at)
                    self.bar.value = share
                    self._tell()
            elif isinstance(result, FlexhinfError):
                self._refuse(result)
                if revision == self.revision:
                    self._outdated(True)
                    self.bar.visible = False
                    self.status.text = "not computed; grey: the last good result"
            elif isinstance(result, Replay):
                self._show_replay(result)
            elif isinstance(result, (Nominal, Band, LinearParts)) and revision == self.revision:
                self.session.keep(result)
                self._show_stage(result)

    def _show_stage(self, stage: Nominal | Band | LinearParts) -> None:
        name = {Nominal: "step", Band: "band", LinearParts: "linear"}[type(stage)]
        self.seconds = {} if isinstance(stage, Nominal) else self.seconds
        self.seconds[name] = stage.seconds
        if isinstance(stage, Nominal):
            self.errors.clear()
            self._outdated(False)
            self.session.band = self.session.linear = None
            self._show_nominal(stage)
        elif isinstance(stage, Band):
            self._show_band(stage)
        else:
            self._show_linear(stage)
        self._show_tiles()
        self.bar.visible = False
        parts = ", ".join(f"{part} {number_text(spent, 's', 2)}" for part, spent in self.seconds.items())
        total = time.perf_counter() - self.requested_at
        self.took = total if name == "linear" else self.took
        self.status.text = f"{parts}; {number_text(total, 's', 2)} since the change" + (
            "" if name == "linear" else " …"
        )

    def _stamp(self, part: str) -> dict[str, Any]:
        return {"part": part, "revision": self.revision}

    def _show_nominal(self, nominal: Nominal) -> None:
        names = nominal.step.joints
        self.joint = min(self.joint, len(names) - 1)
        scales = drawing.Scales(nominal, self.joint)
        self.step.show(
            series=drawing.step_series(nominal, self.joint),
            stale=["all", "most", "linear"],
            ylabel=f"link, {scales.position}",
            order=["all", "most", "command", "linear", "nominal", "picked"],
            stamp=self._stamp("step"),
            description=f"Step of {names[self.joint]}: {_metrics_text(nominal.step, self.joint, scales.effort)}",
        )
        self.effort.show(
            series=drawing.effort_series(nominal, self.joint),
            ylabel=f"input, {scales.effort}",
            order=["upper", "lower", "linear", "nominal", "picked"],
            stale=["linear"],
            description=f"Input of {names[self.joint]}: at most "
            f"{number(nominal.step.peak_inputs[self.joint], 3)} {scales.effort}",
        )
        self._state_buttons(nominal)
        self._show_error(nominal)
        if len(names) > 1:  # whose band takes its time
            self._show_arm(nominal)

    def _show_arm(self, nominal: Nominal) -> None:
        frames = drawing.arm_frames(nominal, nominal.step)
        self.arm.show(**frames, description=f"The arm {nominal.robot.name} in the nominal step")

    def _state_buttons(self, nominal: Nominal) -> None:
        names = drawing.estimated_names(nominal)
        own = [
            name
            for name in names
            if len(nominal.step.joints) == 1 or name.endswith(f"_{nominal.step.joints[self.joint]}")
        ]
        if self.state not in own:
            self.state = own[0] if own else ""
        if getattr(self, "_own", None) == own:
            return
        self._own = own
        self.states.clear()
        self.state_buttons: dict[str, ui.button] = {}
        with self.states:
            if own:
                ui.label("Error of")
            for name in own:
                short = name.removesuffix(f"_{nominal.step.joints[self.joint]}").replace("_", " ")
                button = plain_button(short, lambda name=name: self.choose_state(name))
                self.state_buttons[name] = button.props(f"data-testid=state-{name}")

    def _show_error(self, nominal: Nominal) -> None:
        name = self.state
        for each, button in self.state_buttons.items():
            mark_chosen(button, each == name)
        unit = drawing.Scales(nominal, self.joint).of_state(nominal, name)[1] if name else ""
        text = f"Estimation error of {name}" if name else "The true state is fed back: there is no estimate."
        self.error.show(
            series=drawing.error_series(nominal, name, self.joint),
            ylabel=f"error, {unit}" if unit else "",
            order=["deviation", "nominal", "picked"],
            description=text,
        )

    def _show_band(self, band: Band) -> None:
        effort = drawing.Scales(band.nominal, self.joint).effort
        count = 0 if band.samples is None else len(band.samples)
        self.step.show(
            series=drawing.band_series(band, self.joint),
            stamp=self._stamp("band"),
            description=f"Step of {band.nominal.step.joints[self.joint]}: "
            f"{_metrics_text(band.nominal.step, self.joint, effort)}; band of {count} robots",
        )
        if len(band.nominal.step.joints) == 1:
            self._show_arm(band.nominal)
        if count < band.stated:
            self._note(f"The band has {count} of {band.stated} robots; flexhinf design runs all of them.")

    def _show_linear(self, linear: LinearParts) -> None:
        if linear.failure:
            self._note(f"The linear loop has no equilibrium: {linear.failure}")
        poles = drawing.pole_series(linear)
        step, effort = drawing.linear_series(linear, self.joint)
        self.step.show(series={"linear": step})
        self.effort.show(series={"linear": effort})
        self.sensitivity.show(
            series=drawing.sensitivity_series(linear),
            ylabel="gain",
            order=["limit", "T", "S"],
            stamp=self._stamp("linear"),
            description="Largest singular values of S and T of the running loop",
        )
        self.poles.show(
            series=poles,
            ylabel="imaginary part, rad/s",
            order=["robot", "loop"],
            description="Poles of the loop",
        )

    def _show_replay(self, replay: Replay) -> None:
        band, run = replay.band, replay.run
        if self.session.band is not band:
            return  # of an earlier design
        nominal, who = band.nominal, "nominal robot" if replay.k < 0 else f"robot {replay.k + 1}"
        effort_unit = drawing.Scales(nominal, self.joint).effort
        step, effort, error = (
            (None, None, None)
            if replay.k < 0
            else drawing.picked_series(nominal, run, self.joint, self.state)
        )
        self.step.show(series={"picked": step}, stamp=self._stamp("replay"))
        self.effort.show(series={"picked": effort})
        self.error.show(series={"picked": error})
        self.arm.show(**drawing.arm_frames(nominal, run), restart=True, description=f"The arm of {who}")
        differs = (
            ""
            if replay.k < 0 or band.samples is None
            else _differences(nominal, band.samples.values[replay.k])
        )
        self._note(f"Replayed: {who}. {_metrics_text(run, self.joint, effort_unit)}{differs}")

    def _redraw(self) -> None:
        nominal, band, linear = self.session.nominal, self.session.band, self.session.linear
        if nominal is not None:
            self._show_nominal(nominal)
        if band is not None:
            self._show_band(band)
        if linear is not None:
            self._show_linear(linear)

    def _show_tiles(self) -> None:
        session = self.session
        assert session.nominal is not None
        for key, tile in tiles_of(session.nominal, session.band, session.linear).items():
            self._show_tile(key, tile)

    def _show_tile(self, key: str, tile: Tile) -> None:
        element, number, beside = self.tiles[key]
        number.text, beside.text = tile.number, tile.beside
        for name, on in (("studio-good", tile.good is True), ("studio-bad", tile.good is False)):
            element.classes(**{"add" if on else "remove": name})

    def _show_controls(self) -> None:
        session, links = self.session, self.session.robot.links
        scales = (display_scale(unit, session.specification.in_degrees) for unit in links.position_units)
        unit = " or ".join(sorted({unit for _, unit in scales}, key="m".__eq__))
        for row in self.rows:
            if row.control.field in ("pose", "start"):
                row.label.text = f"{row.control.label}, {unit}"
            text = controls.current_text(row.control, session.specification, session.tolerances, links.slides)
            value = controls.current_value(
                row.control, session.specification, session.tolerances, session.robot
            )
            row.show(text, value)


def _is_finite(value: object) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value)


def _metrics_text(run: Response, joint: int, effort: str) -> str:
    if run.diverged_at is not None:
        return f"it diverges after {number(run.diverged_at, 3)} s"
    row = run.metrics[joint]
    settling = row.get("settling_time_s")
    settles = (
        ""
        if "settling_time_s" not in row
        else f"settles in {number(settling, 3)} s, "
        if settling is not None
        else "does not settle, "
    )
    return (
        f"{settles}overshoot {number(row.get('overshoot_percent', 0.0), 3)} %, "
        f"peak input {number(row['peak_input'], 3)} {effort}"
    )


def _differences(nominal: Nominal, values: Mapping[str, ArrayLike], most: int = 3) -> str:
    """The parameters of a plant that differ most from the nominal ones, in per cent."""
    own, rows = nominal.robot.plant_parameters(), list[tuple[float, str]]()
    for name, value in values.items():
        pairs: Sequence[tuple[float, float]] = list(zip(_flat(value), _flat(own.get(name, value))))
        rows += [
            (abs(a / b - 1.0), f"{name.replace('_', ' ')} {100.0 * (a / b - 1.0):+.2g} %")
            for a, b in pairs
            if b
        ]
    return "".join(f"; {text}" for _, text in sorted(rows, reverse=True)[:most])


def _flat(value: ArrayLike) -> list[float]:
    import numpy as np

    return np.asarray(value, dtype=float).ravel().tolist()
