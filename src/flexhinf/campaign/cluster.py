"""Batches of a campaign on a cluster of Dask's: the journal stays with the driver, workers only compute."""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from flexhinf import __version__
from flexhinf.campaign.batches import Campaign
from flexhinf.campaign.driver import Executor, next_batches
from flexhinf.campaign.samples import Rows, run_batch
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.untrusted import value_text

#: Batches on the way for each thread of the cluster; and how long a scheduler may take to answer, s.
AHEAD, PATIENCE = 2, 10.0


def in_cluster(address: str) -> Executor:
    """An executor on the workers of a scheduler of Dask's, ``tcp://host:8786``.

    A worker that dies costs time: its batches go to the others. A scheduler that dies ends the campaign with what is
    written; the same call goes on. The workers need flexhinf of the driver's version.

    Raises
    ------
    InvalidInput
        For an address of another form, or where `distributed` is not installed.
    """
    if not isinstance(address, str) or "://" not in address:
        raise InvalidInput(
            "The address of the cluster cannot be read.",
            f"expected tcp://HOST:PORT, got {value_text(address)}",
            "tcp://localhost:8786, which `dask scheduler` prints",
        )
    try:
        import distributed  # type: ignore[import-not-found]  # noqa: F401
    except ImportError as error:
        raise InvalidInput(
            "A campaign on a cluster needs distributed, which is not installed.",
            "expected the extra 'cluster'",
            "pip install 'flexhinf[cluster]'",
        ) from error

    def run(campaign: Campaign, batches: Sequence[int]) -> Iterator[tuple[int, Rows]]:
        with _connected(address) as client:
            yield from _run(client, address, campaign, batches)

    return run


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    from distributed import Client  # type: ignore[import-not-found]

    try:
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InvalidInput(
            "The cluster does not answer.",
            f"expected a scheduler at {address}, got {value_text(str(error))}",
            "`dask scheduler` there, and `dask worker` with its address",
        ) from error
    try:
        yield client
    finally:
        client.close(timeout=PATIENCE)


def _run(client: Any, address: str, campaign: Campaign, batches: Sequence[int]) -> Iterator[tuple[int, Rows]]:
    """Batches as they are done, a few for each thread on the way."""
    import cloudpickle  # type: ignore[import-not-found]
    from distributed import CancelledError, KilledWorker, as_completed  # type: ignore[import-not-found]

    sent, rest, begun, done = cloudpickle.dumps(campaign), iter(batches), {}, as_completed(loop=client.loop)
    try:
        while True:
            room = AHEAD * max(1, sum(client.nthreads().values())) - len(begun)
            for batch in next_batches(rest, room):
                future = client.submit(remote_batch, sent, batch, __version__, pure=False)
                begun[future] = batch
                done.add(future)
            if not begun:
                return
            future = next(done)
            rows = future.result()
            yield begun.pop(future), rows
    except (CancelledError, KilledWorker, OSError) as error:
        raise FlexhinfError(
            "The cluster was lost, or its workers die; what is written stays.",
            f"{address}: {type(error).__name__}: {str(error)[:200]}",
            "the same command, once the cluster runs again; smaller batches where memory is what workers lack",
        ) from error
    finally:
        for future in begun:
            future.release()


def remote_batch(sent: bytes, batch: int, version: str) -> Rows:
    """On a worker: the rows of a batch of a pickled campaign."""
    if version != __version__:
        raise InvalidInput(
            "The workers run another version of flexhinf.",
            f"expected {version}, got {__version__}",
            "the driver's version on every worker",
        )
    return run_batch(_campaign(sent), batch)


@lru_cache(2)
def _campaign(sent: bytes) -> Campaign:
    return pickle.loads(sent)
