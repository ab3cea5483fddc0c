"""Every command and every program of README.md, the pages of docs and the examples' docstrings runs as it is printed.

The blocks of a page run one after the other, each as one script, in a folder that begins with the files that the page
shows. What the same command left on another page is brought back from the store of the run. Every ``flexhinf`` must be
called, after ``&&``, ``;`` and pipes too, and each ends with exit code 0. Where one does not, a comment at the end of
its line tells the reader, and the command's output has the comment's words:

    flexhinf design arm.toml   # exit code 1: Not met: overshoot
    flexhinf run arm --mujoco  # exit code 0, or 1 if deadlines were missed

A line whose comment ends with ``needs clang and lld`` is left out where one of these is not installed.

What a page quotes as ``prints "…"`` between a block and the next one is in the output of that block. Commands that set
up an environment need a network: make's are looked up in the Makefile, pip's extras in pyproject.toml.
"""

from __future__ import annotations

import ast
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest
from pathlib import Path

import pytest
from tests import served, workspaces
from tests.store import COLUMNS, INTERPRETER

REPOSITORY = Path(__file__).resolve().parents[2]
LANGUAGES = {"sh", "python", "toml", "xml", "csv", "c", "text"}
#: The program of each package that a command may need.
PROGRAMS = {"clang": "clang", "lld": "wasm-ld"}
#: Blocks of `make nightly`, each alone in a folder with the files of its page, and what does the same with less.
NIGHTLY = {
    "docs/campaigns.md-2": "moves of a workspace; tests/cli/test_workspace.py makes fewer",
    "docs/campaigns.md-5": "searches a disturbance; so does tests/cli/test_campaign.py",
    "docs/campaigns.md-8": "designs two laws; tests/cli/test_campaign_compare.py compares smaller ones",
    "docs/certificate.md-2": "a proof of 20 s; tests/cli/test_workspace.py makes one of one joint",
    "docs/comparison.md-1": "compares over a workspace; docs/drives.md-3 does it with one joint",
    "docs/comparison.md-3": "tunes fourteen laws; tests/cli/test_compare.py compares fewer",
    "docs/design.md-2": "a stated behaviour; tests/cli/test_design.py asks for one",
    "docs/design.md-3": "a design of one pose, as docs/deployment.md-1",
    "docs/design.md-6": "carries a payload with two links; tests/cli/test_workspace.py with one",
    "docs/hardware.md-2": "designs seven joints; docs/design.md-1 has two, tests/cli/test_workspace.py a payload",
    "docs/identify.md-4": "designs twice; tests/identification/test_circle.py does it in Python",
    "docs/moves.md-4": "judged by a move, of two links; tests/cli/test_design.py has one link",
    "docs/moves.md-6": "goals in space; tests/cli/test_design.py has others, tests/designs/test_cartesian.py these",
    "docs/moves.md-7": "one more command; tests/cli/test_design.py has one, tests/designs/test_plans.py shapes steps",
    "docs/moves.md-8": "two designs; below it runs with a smaller search",
    "docs/package.md-2": "two designs; README.md-2 has one in Python, docs/robots.md-7 the other",
    "docs/robots.md-4": "a design of a file of one's own, as docs/start/index.md-4",
    "docs/robots.md-5": "as the program of that page, docs/robots.md-7",
    "docs/robots.md-6": "extras, as in tests/designs/test_limit_cycle.py",
    "docs/robots.md-10": "reads a URDF, as docs/start/index.md does",
    "docs/robots.md-18": "reads a URDF, as docs/start/index.md does",
    "docs/start/index.md-8": "one more design; docs/start/index.md-4 has one, docs/start/index.md-9 that file",
    "docs/theorem.md-1": "checks every cell in rationals; docs/certificate.md checks a sample",
    "docs/weights.md-1": "a proof for all tolerances, as in tests/designs/test_proved_step.py",
}
LONG = {"design", "compare", "paper", "campaign", "estimate", "identify", "certify"}

_FENCE = re.compile(r"^```(\w*|\{[\w-]+\}[^\n]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_FILE = re.compile(r"^(?:#|<!--) file: (\S+)")
_CODES = re.compile(r"# exit code (1|0, or 1)(?: if|:) (.+)$")
_QUOTED = re.compile(r'prints\s+"([^"]+)"')
_NEEDS = re.compile(r"# (?:.* )?needs (\w+(?: and \w+)*)$")
_HERE = re.compile(r"<<-?\s*['\"]?(\w+)")


# Pages ----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Command:
    """One ``flexhinf``, ``make`` or ``pip`` of a block.

    Attributes
    ----------
    words : tuple of str
        The program's name without its folder, and the arguments.
    codes : tuple of int
        Exit codes that the page allows.
    reason : str
        What the output says where the code is 1.
    """

    words: tuple[str, ...]
    codes: tuple[int, ...] = (0,)
    reason: str = ""

    @property
    def long(self) -> bool:
        """Whether it designs."""
        return self.words[0] == "flexhinf" and self.words[1] in LONG and "--help" not in self.words


@dataclass(frozen=True)
class Block:
    """One fenced block.

    Attributes
    ----------
    page : str
        Its file, from the repository's folder.
    number : int
        Of all fenced blocks of the page, from 1.
    language, text : str
    quoted : tuple of str
        What the page says that it prints.
    """

    page: str
    number: int
    language: str
    text: str
    quoted: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """For the list of tests."""
        return f"{self.page}-{self.number}"

    @property
    def file(self) -> str | None:
        """The name of the file that the block shows, from its first line ``# file: NAME``."""
        match = _FILE.match(self.text)
        return match[1] if match else None

    @cached_property
    def commands(self) -> list[Command]:
        """What it calls, in order."""
        return [command for line in logical_lines(self.text) for command in commands_of(line)]


def logical_lines(text: str) -> list[str]:
    """Lines, those that a backslash continues joined, without here-documents."""
    found, end = [], None
    for line in text.replace("\\\n", " ").splitlines():
        if end is None:
            found.append(line)
            here = _HERE.search(line)
            end = here[1] if here else None
        elif line.strip() == end:
            end = None
    return found


def commands_of(line: str) -> list[Command]:
    """The commands of one line; a claim of another exit code is the last one's."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    parts: list[list[str]] = [[]]
    file = False  # whether the next word is one that is read or written
    for word in lexer:
        if set(word) <= set("();|&"):
            parts.append([])
        elif not file and not set(word) <= set("<>"):
            parts[-1].append(word)
        file = set(word) <= set("<>")
    called = [(part[0].rpartition("/")[2], *part[1:]) for part in parts if part]
    known = [words for words in called if words[0] in ("flexhinf", "make", "pip")]
    claim = _CODES.search(line)
    own = [Command(words) for words in known]
    if claim:
        own[-1] = Command(own[-1].words, (1,) if claim[1] == "1" else (0, 1), claim[2])
    return own


def blocks_of(page: Path) -> list[Block]:
    """Its fenced blocks, each with what the text up to the next one quotes."""
    text, name = page.read_text(encoding="utf-8"), page.relative_to(REPOSITORY).as_posix()
    fences = [fence for fence in _FENCE.finditer(text) if not fence[1].startswith("{")]  # no directives
    found = []
    for number, (fence, after) in enumerate(zip_longest(fences, fences[1:]), 1):
        said = text[fence.end() : after.start() if after else len(text)]
        quoted = tuple(" ".join(words.split()) for words in _QUOTED.findall(said))
        found.append(Block(name, number, fence[1], fence[2], quoted))
    return found


def possible(block: Block, found: Callable[[str], str | None] = shutil.which) -> Block:
    """The block without the lines that need what is not installed; `found` looks a program up."""
    lines = block.text.replace("\\\n", " ").splitlines(keepends=True)
    kept = []
    for line in lines:
        match = _NEEDS.search(line.rstrip())
        if all(found(PROGRAMS[name]) for name in (match[1].split(" and ") if match else ())):
            kept.append(line)
    return block if len(kept) == len(lines) else replace(block, text="".join(kept))


def docstring_blocks(example: Path) -> list[Block]:
    """The indented commands of an example's docstring."""
    said = ast.get_docstring(ast.parse(example.read_text(encoding="utf-8"))) or ""
    lines = re.findall(r"^ +(flexhinf .*)$", said, re.MULTILINE)
    name = example.relative_to(REPOSITORY).as_posix()
    return [Block(name, number, "sh", f"{line}\n") for number, line in enumerate(lines, 1)]


PAGES = [
    REPOSITORY / "README.md",
    REPOSITORY / "CONTRIBUTING.md",
    *sorted((REPOSITORY / "docs").rglob("*.md")),
]
EXAMPLES = sorted((REPOSITORY / "examples").glob("*.py"))
#: Calls of programs that are slow: each designs, compiles or runs hundreds of robots.
LONG_CALLS = (
    "fh.design(",
    "fh.run_campaign(",
    "fh.export_c(",
    ".ensemble(",
    "fh.identify(",
    "fh.excitation(",
    "fh.filter_log(",
)
#: Commands of a page above which their starts alone are long.
SEVERAL = 4
BLOCKS = [block for page in PAGES for block in blocks_of(page)]
BLOCKS += [block for example in EXAMPLES for block in docstring_blocks(example)]


def _tier(name: str, blocks: list[Block]) -> list[pytest.MarkDecorator]:
    """When commands run; those that design are long."""
    if name in NIGHTLY:
        return [pytest.mark.nightly(NIGHTLY[name])]
    several = sum(len(block.commands) for block in blocks) > SEVERAL
    long = several or any(command.long for block in blocks for command in block.commands)
    return [pytest.mark.ci("runs each command of the page")] * long


def chains() -> list[object]:
    """The blocks of commands of each page, in its order; those of `make nightly` each alone."""
    pages: dict[str, list[Block]] = {}
    for block in BLOCKS:
        if block.language == "sh":
            pages.setdefault(block.name if block.name in NIGHTLY else block.page, []).append(block)
    return [pytest.param(blocks, id=name, marks=_tier(name, blocks)) for name, blocks in pages.items()]


def programs() -> list[object]:
    return [
        pytest.param(
            block,
            id=block.name,
            marks=[pytest.mark.nightly(NIGHTLY[block.name])]
            if block.name in NIGHTLY
            else [pytest.mark.ci("designs, compiles or runs hundreds of robots")]
            * any(call in block.text for call in LONG_CALLS),
        )
        for block in BLOCKS
        if block.language == "python"
        and not (block.file and f"python {block.file}" in commands_text(block.page))
    ]


def commands_text(page: Path) -> str:
    """The text of all commands of a page, which may run the programs that it shows as files."""
    return "\n".join(block.text for block in BLOCKS if block.page == page and block.language == "sh")


# Running --------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Outcome:
    """What a script did.

    Attributes
    ----------
    codes : dict of str to list of int
        Exit codes of each call of flexhinf, by its words.
    failed : set of int
        Exit codes other than 0 of anything.
    output : str
        Of both streams, its blanks and lines one space each.
    """

    codes: dict[str, list[int]]
    failed: set[int]
    output: str


def run_script(text: str, folder: Path, flexhinf: str = f'"{sys.executable}" -m tests.store "$@"') -> Outcome:
    """Run it as it is printed, in `folder`/work; tests of this file have another program as `flexhinf`."""
    work, bin = folder / "work", folder / "work" / ".venv" / "bin"
    bin.mkdir(parents=True, exist_ok=True)
    calls, statuses = folder / "calls", folder / "statuses"
    for earlier in (calls, statuses):
        earlier.unlink(missing_ok=True)
    for name in ("flexhinf", "make", "pip"):
        run = flexhinf if name == "flexhinf" else ":"
        note = f"printf '%s\\t%s\\n' \"$code\" \"{name} $*\" >> '{calls}'"
        (bin / name).write_text(f"#!/bin/sh\n{run}\ncode=$?\n{note}\nexit $code\n", encoding="utf-8")
        (bin / name).chmod(0o755)
    (bin / "python").write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n', encoding="utf-8")
    (bin / "python").chmod(0o755)
    watch = f'set -T -o pipefail\ntrap \'printf "%s\\n" "$?" >> {shlex.quote(str(statuses))}\' DEBUG\n'
    paths = [str(REPOSITORY / "src"), str(REPOSITORY), os.environ.get("PYTHONPATH", "")]
    environment = {
        **os.environ,
        "PATH": os.pathsep.join([str(bin), os.environ["PATH"]]),
        "PYTHONPATH": os.pathsep.join(path for path in paths if path),
        "MPLBACKEND": "Agg",
        "COLUMNS": COLUMNS,
    }
    done = subprocess.run(
        ["bash", "-c", watch + text], cwd=work, env=environment, capture_output=True, text=True, check=False
    )
    codes: dict[str, list[int]] = {}
    for line in calls.read_text(encoding="utf-8").splitlines() if calls.exists() else []:
        code, words = line.split("\t", 1)
        codes.setdefault(words, []).append(int(code))
    failed = {int(line) for line in statuses.read_text(encoding="utf-8").split()} | {done.returncode}
    return Outcome(codes, failed - {0}, " ".join((done.stdout + done.stderr).split()))


def mistakes(block: Block, outcome: Outcome) -> list[str]:
    """Where a block did not do what its page says."""
    found, explained = [], set[int]()
    codes = {words: iter(each) for words, each in outcome.codes.items()}
    for command in block.commands:
        words = " ".join(command.words)
        code = next(codes.get(words, iter(())), None)
        if code is None:
            found.append(f"never called: {words}")
            continue
        explained.add(code)
        if code not in command.codes:
            found.append(f"exit code {code} instead of {command.codes}: {words}")
        elif code and command.reason not in " ".join(outcome.output.split()):
            found.append(f"exit code {code}, but not because {command.reason!r}: {words}")
    found += [f"exit code {code} of another command" for code in outcome.failed - explained]
    found += [f"not printed: {text}" for text in block.quoted if not _says(outcome.output, text)]
    return found + ["a traceback"] * ("Traceback" in outcome.output)


def _says(output: str, text: str) -> bool:
    """Whether the output has the text; an ellipsis stands for anything."""
    return re.search(".*".join(map(re.escape, text.split("…"))), output) is not None


def write_files(page: str, folder: Path) -> None:
    """Write the files that a page shows into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for block in BLOCKS:
        if block.page == page and block.file:
            (folder / block.file).write_text(block.text, encoding="utf-8")


@pytest.fixture(scope="module")
def interpreter() -> Iterator[str]:
    """Commands and programs of pages are forks of one interpreter: each has a second less to import."""
    with served.interpreter() as address:
        yield address


# Tests ----------------------------------------------------------------------------------------------
@pytest.mark.costs("runs flexhinf for each command")
@pytest.mark.parametrize("blocks", chains())
def test_every_command_of_a_page_runs_as_it_is_printed(
    blocks: list[Block], interpreter: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(INTERPRETER, interpreter)
    targets = re.findall(r"^([\w-]+):", (REPOSITORY / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    write_files(blocks[0].page, tmp_path / "work")
    for block in blocks:
        assert block.commands, block.text
        for program, *arguments in (command.words for command in block.commands):
            if program == "make":
                assert set(arguments) <= set(targets), arguments
            if program == "pip":
                extras = {extra for word in arguments for extra in re.findall(r"\[([\w,]+)\]", word)}
                names = {name for extra in extras for name in extra.split(",")}
                assert names <= set(project["optional-dependencies"])
    absent = []
    for block in blocks:
        able = possible(block)
        absent += [block.name] * (able is not block)
        if able.commands:
            outcome = run_script(able.text, tmp_path)
            assert mistakes(able, outcome) == [], (block.name, outcome.output[-2000:])
    if absent:
        pytest.skip(f"missing: what {', '.join(absent)} say that they need; the rest ran")


@pytest.mark.ci("designs with few poses, goals and bandwidths")
@pytest.mark.usefixtures("unoptimised")
def test_the_program_of_moves_runs_with_a_smaller_search(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As it is printed; what it designs is looked for among less."""
    monkeypatch.chdir(tmp_path)
    (block,) = (block for block in BLOCKS if block.name == "docs/moves.md-8")
    workspaces.few(monkeypatch, POSES=3, GOALS=1, CHOSEN_POSES=2, MODAL_POSES=20, BANDWIDTHS=(28.0,))
    exec(compile(block.text, block.name, "exec"), {"__name__": "__main__"})


#: Instead of flexhinf: says what it is asked, and cannot do "wrong".
ECHO = 'echo "$@"; test "$1" != wrong'


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("flexhinf a && flexhinf b\n", []),
        ("mkdir a && cd a && flexhinf a > list && wc -l < list\n", []),
        ("flexhinf a | cat\n", []),
        ("cat > a <<'END'\nflexhinf nothing\nEND\nflexhinf a\n", []),
        ("flexhinf wrong && \\\n    flexhinf a\n", ["exit code 1", "never called: flexhinf a"]),
        ("flexhinf wrong; flexhinf a\n", ["exit code 1"]),
        ("flexhinf wrong | cat\nflexhinf a\n", ["exit code 1"]),
        ("flexhinf wrong || flexhinf a\n", ["exit code 1"]),
        ("false; flexhinf a\n", ["exit code 1 of another command"]),
        ("false && true\nflexhinf a\n", ["exit code 1 of another command"]),
        ("true || flexhinf a\n", ["never called"]),
        ("flexhinf a  # exit code 1: Not met\n", ["exit code 0 instead of (1,)"]),
        ("flexhinf wrong  # exit code 1: wrong\n", []),
        ("flexhinf wrong  # exit code 1: other reason\n", ["exit code 1, but not because 'other reason'"]),
        ("flexhinf a; flexhinf wrong  # exit code 0, or 1 if wrong\n", []),
        ("flexhinf wrong; flexhinf a  # exit code 0, or 1 if wrong\n", ["exit code 1 instead of (0,)"]),
    ],
)
def test_no_part_of_a_chain_is_lost(text: str, expected: list[str], tmp_path: Path) -> None:
    found = mistakes(Block("page", 1, "sh", text), run_script(text, tmp_path, ECHO))
    assert len(found) == len(expected), found
    assert all(mistake.startswith(start) for mistake, start in zip(found, expected, strict=True)), found


def test_what_is_not_installed_is_not_run() -> None:
    block = Block(
        "page", 1, "sh", "flexhinf a\nflexhinf b && \\\n  flexhinf c  # a page; needs clang and lld\n"
    )
    assert possible(block, lambda name: name) is block
    for missing in PROGRAMS.values():
        found = possible(block, lambda name, missing=missing: None if name == missing else name)
        assert [command.words[1] for command in found.commands] == ["a"]


def test_what_a_page_quotes_must_be_printed(tmp_path: Path) -> None:
    text = "flexhinf 0 of 2000 failed, worst 1.83\n"
    outcome = run_script(text, tmp_path, ECHO)
    for quoted, expected in (("of 2000 failed", []), ("0 of … 1.83", []), ("1.84", ["not printed: 1.84"])):
        assert mistakes(Block("page", 1, "sh", text, (quoted,)), outcome) == expected


def test_no_block_is_left_out() -> None:
    assert {block.language for block in BLOCKS} <= LANGUAGES  # none without: it would not be run
    assert len(chains()) > 10
    assert {block.name for block in BLOCKS} >= NIGHTLY.keys()
    assert len(programs()) >= 4
    nameless = [block.name for block in BLOCKS if block.language in ("toml", "xml", "csv") and not block.file]
    assert nameless == []


def test_commands_that_do_not_run_here_have_options_that_exist() -> None:
    """Commands between single backquotes have placeholders; those of `make nightly` run seldom."""
    from typer.main import get_command

    from flexhinf.cli.commands import app

    whole = get_command(app)
    for page in (*PAGES, REPOSITORY / "CHANGELOG.md"):
        prose = _FENCE.sub("", page.read_text(encoding="utf-8"))
        shown = [block for block in BLOCKS if block.language == "sh" and REPOSITORY / block.page == page]
        for text in (
            *re.findall(r"`flexhinf ([^`]*)`", prose),
            *(
                shlex.join(each.words[1:])
                for block in shown
                if block.name in NIGHTLY
                for each in block.commands
            ),
        ):
            command, words = whole, text.split()
            while words and words[0] in getattr(command, "commands", ()):
                command = command.commands[words.pop(0)]  # pyright: ignore[reportAttributeAccessIssue]
            command = getattr(command, "commands", {}).get("run", command)  # `flexhinf campaign DESIGN`
            known = {option for parameter in command.params for option in parameter.opts}
            known |= {option for parameter in command.params for option in parameter.secondary_opts}
            asked = {word.strip("[]").split("=")[0] for word in words if word.lstrip("[").startswith("--")}
            assert asked <= known | {"--help"}, f"{page.name}: flexhinf {text}"


def test_modules_and_files_that_python_is_told_to_run_exist() -> None:
    for page in (*PAGES, *EXAMPLES):
        shown = {block.file for block in BLOCKS if block.page == page.relative_to(REPOSITORY).as_posix()}
        for module, file in re.findall(
            r"python (?:-m ([\w.]+)|([\w/]+\.py))", page.read_text(encoding="utf-8")
        ):
            path = REPOSITORY / (file or module.replace(".", "/"))
            known = path.exists() or path.with_suffix(".py").exists() or module in ("pytest", "flexhinf")
            known = known or file in shown
            assert known, f"{page.name}: python {module or file}"


@pytest.mark.ci("starts the interpreter of the programs below")
@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        ("print(__name__)", 0, ""),
        ("raise SystemExit(3)", 3, ""),
        ("import warnings; warnings.warn('late')", 1, "UserWarning: late"),
        ("import os; os.kill(os.getpid(), 9)", 137, ""),
    ],
)
def test_a_program_that_fails_is_no_success(
    text: str, code: int, said: str, interpreter: str, tmp_path: Path
) -> None:
    done = served.ask(interpreter, served.program, (text,), tmp_path)
    assert done.code == code
    assert done.output == "__main__\n" * (code == 0)
    assert said in done.errors


@pytest.mark.ci("runs each program")
@pytest.mark.parametrize("block", programs())
def test_every_program_runs_as_it_is_printed(block: Block, interpreter: str, tmp_path: Path) -> None:
    """These come last: what the interpreter of all cost is known as it ends."""
    write_files(block.page, tmp_path)
    done = served.ask(interpreter, served.program, (block.text,), tmp_path)
    assert done.code == 0, done.errors
