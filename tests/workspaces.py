"""Fewer poses, goals and bandwidths in designs for a workspace, for tests that look at something else."""

from importlib import import_module
from typing import Any

import pytest

ROOMS = [
    import_module(f"flexhinf.{name}")
    for name in (
        *(
            f"designs.workspace.{room}"
            for room in ("setup", "search", "gain_search", "samples", "design", "robustness", "campaign")
        ),
        "modal.law",
    )
]


def few(patch: pytest.MonkeyPatch, **values: Any) -> None:
    """Set constants, such as `POSES=4` or `BANDWIDTHS=(28.0,)`, in every module that reads them; with few goals there
    are as few further ones. A `MARGIN` near 1 leaves a narrow range of vibrations, of which less is to be proved."""
    further = {"FURTHER": ((values["GOALS"], 0.6, 3.0),)} if "GOALS" in values else {}
    for name, value in (further | values).items():
        rooms = [room for room in ROOMS if hasattr(room, name)]
        assert rooms, name
        for room in rooms:
            patch.setattr(room, name, value)
