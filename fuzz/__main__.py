"""``python -m fuzz``: run the fuzzers and print the table of attempts."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module

from fuzz import FUZZERS


def main() -> int:
    """Run the named fuzzers; exit code 1 where an attempt was neither right nor typed."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("names", nargs="*", help="which fuzzers (default: all)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--times", type=float, default=1.0, help="attempts, as a multiple of the usual number"
    )
    options = parser.parse_args()
    print("| tried | attempts | right | refused by a typed error | neither |", flush=True)
    print("|---|---|---|---|---|", flush=True)
    wrong: list[str] = []
    for name in options.names or FUZZERS:
        fuzzer = import_module(f"fuzz.{name}")
        tally = fuzzer.run(max(1, round(options.times * fuzzer.ATTEMPTS)), options.seed)
        counts = f"{tally.tried} | {tally.right} | {tally.typed} | {len(tally.wrong)}"
        print(f"| {tally.what} | {counts} |", flush=True)
        wrong += [f"{name}: {line}" for line in tally.wrong]
    for line in wrong[:50]:
        print(line, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
