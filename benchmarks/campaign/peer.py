"""A peer in a process and an environment of its own: ``python peer.py NAME`` answers tasks, one line of JSON each.

A task has the constants of the loop once, then for each request the plants and the number of steps. The answer has the
seconds that it took, by the clock and of the processor, and, of the first plants, the results. Nothing of flexhinf is
imported.
"""

from __future__ import annotations

import importlib
import json
import sys
import time

import numpy as np


def main() -> None:
    """Answer until there is nothing more to read."""
    module = importlib.import_module(f"{sys.argv[1]}_loop")
    task = json.loads(sys.stdin.readline())
    print(json.dumps(module.versions()), flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        plants, given = (np.array(request[name], dtype=float) for name in ("plants", "given"))
        start, used = time.perf_counter(), time.process_time()
        found = module.simulate(task, plants, request["steps"], given)
        seconds, processor = time.perf_counter() - start, time.process_time() - used
        print(
            json.dumps({"seconds": seconds, "processor": processor, "found": found[:3].tolist()}), flush=True
        )


if __name__ == "__main__":
    main()
