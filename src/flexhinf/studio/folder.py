"""The working folder: every file that the page reads or writes is named within it."""

# Tables of TOML have no types.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from flexhinf.designs.design_file import is_design_file
from flexhinf.errors import refuse_if
from flexhinf.robot import catalogue
from flexhinf.robot.waypoints import states_range
from flexhinf.validation import checked_path, read_toml, value_text

#: Most names of files that the page offers, and most folders below the working folder that are looked into.
MOST_FILES, MOST_FOLDERS = 200, 50

#: Longest name of a file that the page may send.
LONGEST = 200


@dataclass(frozen=True)
class WorkingFolder:
    """The folder in which the studio was started."""

    root: Path

    def place(self, what: str, name: object) -> Path:
        """The path of a name within the folder; there need not be a file.

        Raises InvalidInput: for what is no text, an absolute path, a name that leads out of the folder, or through a
        symbolic link.
        """
        allowed = f"the name of a {what} in {self.root}, without '..' and links"
        text = name.strip() if isinstance(name, str) else ""
        refuse_if(
            not text or len(text) > LONGEST or not text.isprintable() or text.startswith("~"),
            f"This is no name of a {what}.",
            f"expected {allowed}, got {value_text(name, 80)}",
            "design.toml",
        )
        relative = checked_path(f"The {what}", text)
        root = self.root.resolve()
        path = root / relative
        steps = [path, *(each for each in path.parents if each != root and each.is_relative_to(root))]
        leads_out = (
            relative.is_absolute()
            or "\\" in text
            or ":" in text
            or ".." in relative.parts
            or not path.resolve().is_relative_to(root)
            or any(map(os.path.islink, steps))
        )
        refuse_if(
            leads_out,
            f"The {what} is not in the working folder.",
            f"expected {allowed}, got {value_text(text, 80)}",
            f"a copy of it in {self.root}, or flexhinf studio in its own folder",
        )
        return path

    def designs(self) -> list[str]:
        """Names of the design files in the folder and one level below, by name."""
        folders = [self.root, *sorted(p for p in self._entries(self.root) if p.is_dir())[:MOST_FOLDERS]]
        files = (path for folder in folders for path in sorted(self._entries(folder)))
        named = (p for p in files if p.suffix == ".toml" and p.is_file() and is_design_file(p))
        return [path.relative_to(self.root).as_posix() for path, _ in zip(named, range(MOST_FILES))]

    @staticmethod
    def _entries(folder: Path) -> Iterator[Path]:
        try:
            with os.scandir(folder) as entries:
                names = [e.name for e in entries if not e.name.startswith(".") and not e.is_symlink()]
        except OSError:
            return
        yield from (folder / name for name in names)

    def check_design(self, name: object) -> Path:
        """The path of a design file whose robot, and whatever files that names, are in the folder or the catalogue.

        Raises InvalidInput: for a name as `place` does, and for a file within that leads elsewhere.
        """
        path = self.place("design file", name)
        refuse_if(
            not path.is_file(),
            f"There is no file {value_text(str(name), 80)}.",
            f"expected a design file in {self.root}, got a name without a file",
            "one of the listed files",
        )
        table = read_toml(path, "design file").get("design")
        if not isinstance(table, dict):
            return path  # whoever reads it says so
        for key in ("robot", "elastic", "move", "workspace"):
            value = table.get(key)
            if not isinstance(value, str) or not value.strip() or value in catalogue():
                continue
            if not (key == "workspace" and states_range(value)):
                self._check_within(path.parent, key, value, robot=key in ("robot", "elastic"))
        return path

    def _check_within(self, folder: Path, key: str, value: str, robot: bool) -> None:
        file = self._beside(folder, key, value)
        if not robot or not file.is_file() or file.suffix.lower() != ".toml":
            return
        parts = read_toml(file)
        for kind in ("urdf", "mjcf"):
            if isinstance(parts.get(kind), str):
                self._beside(file.parent, kind, parts[kind])

    def _beside(self, folder: Path, key: str, value: str) -> Path:
        """The file of a name that is seen from a folder; refused outside the working folder."""
        below = os.path.relpath(os.path.normpath(folder / value), self.root.resolve())
        refuse_if(
            Path(value).is_absolute() or below.split(os.sep)[0] == "..",
            f"{key} leads out of the working folder.",
            f"expected a file in {self.root} or a name of the catalogue, got {value_text(value, 80)}",
            f"a copy of it in {self.root}, or flexhinf studio in its own folder",
        )
        return self.place(key, below)

    def free_name(self, name: str, suffix: str = "") -> str:
        """The name, or the first of name-2, name-3, … that no file or folder has."""
        names = (f"{name}{'' if k == 1 else f'-{k}'}{suffix}" for k in range(1, MOST_FILES))
        return next((each for each in names if not os.path.lexists(self.root / each)), f"{name}{suffix}")
