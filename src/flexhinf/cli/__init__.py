"""The door for commands. No mathematics here: options come in, rooms do the work, errors go out in three parts."""

from flexhinf.cli.commands import app, main

__all__ = ["app", "main"]
