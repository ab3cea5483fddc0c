"""A judged claim together with what shows it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from flexhinf.report import Claim

__all__ = ["Judged"]


@dataclass(frozen=True)
class Judged:
    """A claim with its verdict, the tables and figures that show it, and numbers for ``metrics.json``."""

    claim: Claim
    blocks: tuple[Any, ...] = ()
    numbers: dict[str, Any] = field(default_factory=dict)
