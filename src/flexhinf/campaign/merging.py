"""The table of all samples of a journal, which is written while batches run: what is left at the end is its last rows.

The same batches give the same bytes, in whatever order they come.
"""

# pyarrow has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownParameterType=false, reportArgumentType=false

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from functools import cached_property
from itertools import islice, takewhile
from pathlib import Path
from typing import TYPE_CHECKING

from flexhinf.campaign.journal import LISTED, READERS, TABLE, Journal, disk_refusals, publish_whole
from flexhinf.campaign.parquet import TABLE_FORMAT
from flexhinf.errors import refuse_if
from flexhinf.files import make_durable, part_file
from flexhinf.processors import in_threads

if TYPE_CHECKING:
    from pyarrow import Table
    from pyarrow.parquet import ParquetWriter

#: Smallest number of rows of a group in the table.
GROUP = 16_384


class GrowingTable:
    """The table of a journal's campaign, made from the rows of batches in their order, in a thread of its own.

    `good`: Shards by batch. Whoever enters another one, or lets the journal write it, calls `go_on`. Groups of rows are
    forced to the disk one by one; the file gets its name in `finished`. To be closed.
    """

    def __init__(self, journal: Journal, good: Mapping[int, Path]) -> None:
        self.journal, self.good = journal, good
        self._next, self._group = 0, list["Table"]()
        self._error: BaseException | None = None
        self._thread, self._opened = ThreadPoolExecutor(1), ExitStack()

    def go_on(self) -> None:
        """Let the thread take the rows of those batches that are there next; any thread may call it."""
        self._thread.submit(self._take)

    def finished(self, good: Mapping[int, Path]) -> Path:
        """The table, whole, from the shards of all batches; InvalidInput if one is missing."""
        batches = self.journal.batches
        lacking = batches - len(good)
        first = islice((str(batch) for batch in range(batches) if batch not in good), LISTED)
        refuse_if(
            lacking,
            "The campaign is not complete.",
            f"expected {batches} batches, got {len(good)}; missing: "
            f"{', '.join(first)}{' …' if lacking > LISTED else ''}",
            "the campaign's command again, or the folders of the other shards",
        )
        self.good, path = good, self.journal.folder / TABLE
        with disk_refusals(self.journal.folder):
            self._thread.submit(self._take).result()
            if self._error is not None:
                raise self._error
            publish_whole(self._name, path)
        return path

    def close(self) -> None:
        """Remove what is not finished."""
        self._thread.shutdown(cancel_futures=True)
        with suppress(OSError):  # of the rest of a table for which there is no room
            self._opened.close()

    def _take(self) -> None:
        last = self.journal.batches
        try:
            there = [*takewhile(self._is_there, range(self._next, last if self._error is None else 0))]
            for rows in (
                in_threads(self._rows, there, READERS) if len(there) > READERS else map(self._rows, there)
            ):
                self._group.append(rows)
                self.journal.let_go(self._next)
                self._next += 1
                if sum(map(len, self._group)) >= GROUP or self._next == last:
                    self._write()
        except BaseException as error:
            self._error = error

    def _is_there(self, batch: int) -> bool:
        return batch in self.good or self.journal.in_memory(batch)

    def _rows(self, batch: int) -> Table:
        return self.journal.rows(batch, self.good.get(batch), self.journal.table_schema.names)

    def _write(self) -> None:
        """Write a group; after the last batch also what ends the file."""
        from pyarrow import concat_tables

        schema = self.journal.table_schema
        self._writer.write_table(concat_tables(self._group).combine_chunks().cast(schema))
        self._group.clear()
        if self._next == self.journal.batches:
            self._writer.close()
        make_durable(self._name)

    @cached_property
    def _name(self) -> str:
        return self._opened.enter_context(part_file(self.journal.folder, f".{TABLE}."))

    @cached_property
    def _writer(self) -> ParquetWriter:
        from pyarrow import parquet

        return self._opened.enter_context(
            parquet.ParquetWriter(self._name, self.journal.table_schema, **TABLE_FORMAT)
        )
