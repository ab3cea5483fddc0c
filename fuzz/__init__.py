"""Hostile input, drawn from fixed seeds: what is tried is answered rightly or refused by an error of ours.

    python -m fuzz                    every fuzzer; prints the table of docs/promises.md
    python -m fuzz names estimators   only these

A fuzzer is a module here with ``ATTEMPTS`` and ``run(attempts, seed) -> Tally``. ``make nightly`` runs each with seed
0, ``make ci`` a tenth of its attempts; another seed looks elsewhere: ``python -m fuzz --seed 7``.
"""

FUZZERS: tuple[str, ...] = (
    "robot_files",
    "mjcf_options",
    "requests",
    "logs",
    "names",
    "command_line",
    "solution_files",
    "estimators",
    "hostile_filters",
    "random_plants",
    "kills",
    "report_folders",
)
