"""``flexhinf robots``: what ships with flexhinf."""

from __future__ import annotations

__all__ = ["EXAMPLES", "robots"]

EXAMPLES = ("flexhinf robots",)


def robots() -> None:
    """List the robots that ship with flexhinf, and where their numbers come from."""
    from rich.console import Console

    from flexhinf.design.report import robots_table

    Console().print(robots_table())
