"""The catalogue: robots that ship with the package, as robot files with the source of every number."""

from __future__ import annotations

from pathlib import Path

__all__ = ["catalogue"]


def catalogue() -> dict[str, Path]:
    """Path of each shipped robot file by name, for `load_robot`."""
    folder = Path(__file__).parent / "catalogue"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}
