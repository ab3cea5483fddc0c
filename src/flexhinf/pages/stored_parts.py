"""Parts of a report that was read from a folder."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from html import unescape
from typing import Any, cast

from flexhinf.designs.request import DesignRequest
from flexhinf.designs.stored import StoredReport
from flexhinf.errors import InvalidInput
from flexhinf.pages.parts import PARTS, DesignParts
from flexhinf.report import Figure
from flexhinf.report.figure import standalone

#: The drawings that the page of a design begins with, each with its label and its caption.
_LEAD = re.compile(
    r'<figure id="figure-(result(?:-arm)?)"[^>]*><div class="drawing">(<svg.*?</svg>)</div>'
    r"<figcaption[^>]*>(?:<strong>(.*?)\.</strong>)?(.*?)</figcaption>",
    re.DOTALL,
)


@PARTS.register(StoredReport)
def _stored_parts(evidence: StoredReport) -> DesignParts:
    return cast("DesignParts", StoredParts(evidence))  # what it lacks is refused in words


class StoredParts:
    """`DesignParts` of a design that was read from a folder, which has its files."""

    def __init__(self, evidence: StoredReport) -> None:
        self._evidence = evidence

    @property
    def read(self) -> DesignRequest:
        """The request of the folder's design file."""
        return self._evidence.request

    def files(self) -> Mapping[str, str | bytes]:
        """All of the folder but the design file."""
        return self._evidence.files

    def figures(self) -> list[Figure]:
        """What the page in the folder begins with; nothing where it was changed or has gone."""
        with suppress(InvalidInput):
            page = self._evidence.files.get("index.html", "")
            text = page if isinstance(page, str) else page.decode()
            return [
                Figure(name, standalone(svg), _plain(said), _plain(called))
                for name, svg, called, said in _LEAD.findall(text)
            ]
        return []

    def result(self) -> Mapping[str, object]:
        """As the design file has it."""
        return self._evidence.result

    def __getattr__(self, name: str) -> Any:
        raise InvalidInput(
            "This design was read from a folder, which has its page and its numbers.",
            f"expected a design that was made here, got {self._evidence.summary()}",
            "design.save(folder), which writes the same report",
        )


def _plain(html: str) -> str:
    return unescape(re.sub(r"<[^>]*>", "", html)).strip()
