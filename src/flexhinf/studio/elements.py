"""Elements of the page: figure and arm, which JavaScript draws, and the rows of controls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import ui
from nicegui.element import Element

from flexhinf.studio.controls import Control


class LiveFigure(Element, component="figure.js"):
    """Curves on a canvas, see figure.js."""

    def __init__(self, title: str, xlabel: str, **options: bool) -> None:
        super().__init__()
        for name, value in {"title": title, "xlabel": xlabel, **options}.items():
            self._props[name] = value

    def show(self, **data: Any) -> None:
        """Send curves to the browser."""
        self.run_method("show", data)


class ArmView(Element, component="arm.js"):
    """The arm of a run, see arm.js."""

    def __init__(self, title: str) -> None:
        super().__init__()
        self._props["title"] = title

    def show(self, **data: Any) -> None:
        """Send a run to the browser."""
        self.run_method("show", data)


def plain_button(label: str, act: Callable[[], object]) -> ui.button:
    """A button in the page's own colours."""
    return ui.button(label, on_click=lambda: act(), color=None).props("flat dense no-caps")


def mark_chosen(button: ui.button, chosen: bool) -> None:
    """Show whether a button is the chosen one of its group."""
    button.classes(**{"add" if chosen else "remove": "chosen"}).props(f"aria-pressed={str(chosen).lower()}")


class ControlRow:
    """A control: its text and, where it has a range, its slider; `take` is called with a text that the user made."""

    def __init__(self, control: Control, take: Callable[[Control, str], None]) -> None:
        self.control, self._take, self._quiet = control, take, False
        self.current: str | None = None
        self.slider: ui.slider | None = None
        self.text: ui.input | None = None
        self.buttons: dict[str, ui.button] = {}
        name = f"data-testid={control.key}"
        wide = "" if control.has_slider or control.choices else " wide"
        with ui.element("div").classes(f"studio-row{wide}"):
            self.label = ui.label(control.label).classes("studio-label").tooltip(control.help)
            if control.choices:
                with (
                    ui.element("div")
                    .classes("studio-choices")
                    .props(f'role=group aria-label="{control.label}"')
                ):
                    for choice in control.choices:
                        button = plain_button(choice or "auto", lambda choice=choice: take(control, choice))
                        self.buttons[choice] = button.props(f"{name}-{choice or 'auto'}")
                return
            self.text = ui.input(placeholder="auto").props(
                f'dense borderless aria-label="{control.label}" {name}'
            )
            self.text.on("keydown.enter", self._typed).on("blur", self._typed)
            if control.has_slider:
                slider = ui.slider(min=0, max=control.steps, step=1, on_change=self._moved)
                self.slider = slider.props(f'dense aria-label="{control.label}" {name}-slider')

    def _typed(self) -> None:
        if self.text is not None and self.text.value != self.current:
            self._take(self.control, str(self.text.value or ""))

    def _moved(self, event: Any) -> None:
        if not self._quiet and event.value is not None:
            self._take(self.control, self.control.text(float(event.value)))

    def refused(self) -> None:
        """Take the next text, whatever it is: the one that stands there was refused."""
        self.current = None

    def show(self, text: str, value: float) -> None:
        """Show the value that the session has."""
        self.current = text
        for choice, button in self.buttons.items():
            mark_chosen(button, choice == text)
        if self.text is not None:
            self.text.value = text
        if self.slider is not None:
            self._quiet = True
            try:
                self.slider.value = self.control.position(value)
            finally:
                self._quiet = False
