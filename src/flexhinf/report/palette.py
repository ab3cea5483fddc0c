"""Colours of figures and pages, by role, for light and for dark surroundings.

The series colours are those of Okabe and Ito [okabe2008], which readers with any of the common colour-vision
deficiencies can tell apart; in the dark they are the same hues, lighter.
"""

from __future__ import annotations

__all__ = ["DARK", "GRID", "INK", "LIGHT", "MUTED", "SERIES"]

LIGHT: dict[str, str] = {
    "ink": "#1f2328",
    "muted": "#6a737d",
    "grid": "#dfe3e8",
    "series-1": "#0072b2",
    "series-2": "#d55e00",
    "series-3": "#009e73",
    "series-4": "#a6559d",
    "series-5": "#c98a00",
    "series-6": "#3f9bd4",
}
DARK: dict[str, str] = {
    "ink": "#e6e8eb",
    "muted": "#9aa3ad",
    "grid": "#353b43",
    "series-1": "#4fa8e0",
    "series-2": "#ff8b4d",
    "series-3": "#2fc799",
    "series-4": "#d794cf",
    "series-5": "#edbb45",
    "series-6": "#8cc8ee",
}

INK: str = LIGHT["ink"]
MUTED: str = LIGHT["muted"]
GRID: str = LIGHT["grid"]
SERIES: tuple[str, ...] = tuple(colour for role, colour in LIGHT.items() if role.startswith("series-"))
