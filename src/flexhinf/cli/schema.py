"""``flexhinf schema``: the JSON schema of a design file."""

from __future__ import annotations

import json

import typer

__all__ = ["EXAMPLES", "schema"]

EXAMPLES = ("flexhinf schema > design.schema.json",)


def schema() -> None:
    """Print the JSON schema of a design file (design.toml), for editors and other programs."""
    from flexhinf.design import design_schema

    typer.echo(json.dumps(design_schema(), indent=2, ensure_ascii=False))
