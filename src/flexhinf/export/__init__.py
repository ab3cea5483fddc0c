"""A controller as dependency-free C, ready for firmware."""

from __future__ import annotations

from flexhinf.export.names import identifier_of
from flexhinf.export.package import check_room, checked_folder, controller_files, export_c, write_files

__all__ = ["check_room", "checked_folder", "controller_files", "export_c", "identifier_of", "write_files"]
