"""A certificate: a claim that is saved to a file, read from it, and proved again.

A file has numbers in hexadecimal, so that they are read as they were written. Files are not trusted: size, depth, keys,
types, lengths and magnitudes are checked before a number is used.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from flexhinf.certify.checker import Verification, verify
from flexhinf.certify.checker.observer import check_observer
from flexhinf.certify.checker.quadratic import definite_corners
from flexhinf.certify.checker.residual import Refusal, residual
from flexhinf.certify.checker.starts import check_start, proved_peaks
from flexhinf.certify.claim import Claim
from flexhinf.errors import InvalidInput
from flexhinf.files import write_file
from flexhinf.notebook import Summarised, number_text
from flexhinf.validation import checked_path, read_text, value_text

_FORMAT, _VERSION = "flexhinf certificate", 1
_LARGEST = 8_000_000  # bytes: degree 8 in five states takes 200 kB


@dataclass(frozen=True, repr=False)
class Certificate(Summarised, Claim):
    """On the component of {V ≤ level} around 0 the dissipation inequality holds; see `Claim` for the attributes."""

    def check(
        self,
        *,
        threads: int = 2,
        sample: int | None = 10,
        by_cells: bool = False,
        tick: Callable[[int], None] = lambda cells: None,
    ) -> Verification:
        """Prove the certificate again from its data alone; see `flexhinf.certify.checker`.

        Parameters
        ----------
        sample : int
            Cells per face that are proved a second time, in rationals and balls; None: every cell, which takes a
            minute of CPU for degree 2 and hours for degree 6.
        by_cells : bool
            Whether cells are looked at even where definite matrices decide, in rationals and without cells.
        tick : callable
            Gets the number of cells that were just looked at.
        """
        return verify(self, threads=threads, sample=sample, by_cells=by_cells, tick=tick)

    @property
    def is_gradient_law(self) -> bool:
        """Whether the law is −R2⁻¹g2ᵀV_xᵀ up to rounding, with a known g2: for the budget of the theorem."""
        return residual(self).gradient_law

    @property
    def stated(self) -> Verification:
        """The parts of the theorem that depend on the law, for a certificate just proved: no checker is run."""
        return Verification(True, gradient_law=self.is_gradient_law, peaks=proved_peaks(self))

    def definite_corners(self) -> int:
        """The number of corners at which r is a negative definite form, where that proves it without cells; else 0."""
        return definite_corners(self, residual(self))

    def with_proved_starts(self) -> Certificate:
        """This certificate without the starts for which ball arithmetic does not show V ≤ level."""
        inside = []
        for start in self.starts:
            with suppress(Refusal):
                check_start(self, start)
                inside.append(start)
        return replace(self, starts=tuple(inside))

    def why_no_observer(self) -> str:
        """The reason for which the stated observer is refused; empty where it is proved, or none is stated."""
        try:
            if self.observer is not None:
                check_observer(self, self.observer, True)
        except Refusal as refusal:
            return str(refusal)
        return ""

    def summary(self) -> dict[str, str]:
        """For ``repr``: what it claims. `check` proves it again."""
        return {
            "about": self.about,
            "gamma": number_text(self.gamma),
            "level of V": number_text(self.level),
            "degree of V": str(self.degree),
            "step amplitude": number_text(self.step_amplitude),
            "decay": number_text(self.decay, "1/s"),
            "feedback": self.feedback,
        }

    def text(self) -> str:
        """The file's content, JSON."""
        content = {"format": _FORMAT, "version": _VERSION} | _adapter().dump_python(self, mode="json")
        return json.dumps(content, ensure_ascii=False, separators=(",", ":")) + "\n"

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write certificate.json under a temporary name, then rename it.

        Raises
        ------
        InvalidInput
            The place cannot be written.
        """
        write_file(path, "certificate", lambda name: Path(name).write_text(self.text(), encoding="utf-8"))


def load_certificate(path: str | os.PathLike[str]) -> Certificate:
    """Read what `Certificate.save` wrote; nothing is proved by reading.

    Raises
    ------
    InvalidInput
        Not there, too large, no such file, of a newer version, or with contents that no certificate has.
    """
    path = checked_path("The certificate's file", path)
    text = read_text(path, _LARGEST, "JSON", "certificate")
    try:
        content = json.loads(text, object_pairs_hook=_once, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise _unreadable(path.name, "JSON", str(error)) from None
    entries = dict(content) if isinstance(content, dict) else {"format": content}
    kind, version = entries.pop("format", None), entries.pop("version", None)
    unknown = sorted(set(entries) - {entry.name for entry in fields(Certificate)})
    for readable, expected, got in (
        (
            isinstance(content, dict) and kind == _FORMAT,
            f"an object with format = {_FORMAT!r}",
            value_text(kind, 80),
        ),
        (type(version) is int and version == _VERSION, f"version {_VERSION}", value_text(version, 60)),
        (not unknown, "known entries", value_text(unknown, 100)),
    ):
        if not readable:
            raise _unreadable(path.name, expected, got)
    try:
        return _adapter().validate_python(entries)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        cause = first.get("ctx", {}).get("error")
        if isinstance(cause, InvalidInput):
            raise _unreadable(path.name, "a certificate", f"{cause.what} {cause.found}") from None
        where = ".".join(str(part) for part in first["loc"])
        got = value_text(first.get("input"), 80)
        raise _unreadable(path.name, f"{where}: {first['msg']}", got) from None


@cache
def _adapter() -> TypeAdapter[Certificate]:
    return TypeAdapter(Certificate)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len({key for key, _ in pairs}) < len(pairs):
        raise ValueError("a key that stands twice")
    return dict(pairs)


def _no_constant(text: str) -> Any:
    raise ValueError(f"{text} is no number")


def _unreadable(name: str, expected: str, got: str) -> InvalidInput:
    return InvalidInput(
        f"{name}: this is no certificate that can be read.",
        f"expected {expected}; got: {got}",
        "the file that flexhinf certify wrote, unchanged",
    )
