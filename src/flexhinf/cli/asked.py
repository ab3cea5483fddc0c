"""A robot, or a design file, as the argument of a command; with the options that win over the file."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import typer

from flexhinf.cli.given import check_drive, fields
from flexhinf.cli.told import note

if TYPE_CHECKING:
    from flexhinf.design import Asked

__all__ = ["Told", "asked_by"]


@dataclass(frozen=True, eq=False)
class Told:
    """What is asked for, and what was said about it.

    Attributes
    ----------
    asked : Asked
    warnings : list of str
        Of the robot's file; they belong into the report.
    """

    asked: Asked
    warnings: list[str]


def asked_by(context: typer.Context, source: str, elastic: str) -> Told:
    """Robot and specification of a command; notes are told.

    Raises
    ------
    InvalidInput
        For a file or an option that cannot be used.
    """
    from flexhinf.design import asked_of
    from flexhinf.robot import RobotFileWarning

    given = fields(context)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RobotFileWarning)
        asked = asked_of(source, elastic or None, given)
    check_drive(context, asked.robot)
    told = [str(warning.message) for warning in caught if issubclass(warning.category, RobotFileWarning)]
    for text in (*told, *asked.notes):
        note(text)
    return Told(asked, told)
