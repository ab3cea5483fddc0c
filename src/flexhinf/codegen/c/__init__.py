"""A program as C99: no library but ``<math.h>``, no memory but the caller's."""

from flexhinf.codegen.c.algebra import (
    Real as Real,
    comment as comment,
    constant as constant,
    pivot_tolerance as pivot_tolerance,
)
from flexhinf.codegen.c.identifiers import KEYWORDS as KEYWORDS
from flexhinf.codegen.c.layout import folded as folded
from flexhinf.codegen.c.module import Translator as Translator
