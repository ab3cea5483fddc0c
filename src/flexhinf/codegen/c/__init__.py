"""A program as C99: no library but ``<math.h>``, no memory but the caller's."""

from __future__ import annotations

from flexhinf.codegen.c.algebra import Real, constant
from flexhinf.codegen.c.module import Translator

__all__ = ["Real", "Translator", "constant"]
