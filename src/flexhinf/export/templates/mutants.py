"""Which changes of the exported C its tests notice: ``make mutants``, or ``python3 mutants.py [--all] [--seed 1]``.

One line of the source is changed at a time: a comparison turned round, a sign, a product, a number, `and` for `or`, a
statement left out. Then the programs of ``make test`` run. A change that none of them notices *survives*, and is written
to mutants.txt with its line. One that the optimising compiler turns into the same machine code is no change, and neither
is one that does not compile. It needs Python 3.9 or later, and the compiler that CC names.
"""

import argparse
import os
import random
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

NAME = "@{name}"
#: Each source with the programs that test it.
SOURCES = {
    f"{NAME}.c": [f"{NAME}_test", f"{NAME}_contract"],
{% if follows %}
    f"{NAME}_follow.c": [f"{NAME}_follow_test"],
{% endif %}
}
FLAGS = ["-std=c99", "-ffp-contract=off", "-w", f"-D{NAME.upper()}_PLAIN"]
CC = shlex.split(os.environ.get("CC", "cc"))

#: What is changed, and into what; the first group is what a change replaces.
CHANGES = (
    ("comparison", re.compile(r" (<=|>=|==|!=|<|>) "), {"<": ">=", ">": "<=", "<=": ">", ">=": "<", "==": "!=", "!=": "=="}),
    ("logic", re.compile(r" (&&|\|\|) "), {"&&": "||", "||": "&&"}),
    ("sign", re.compile(r"[\w)\]] ([+-]) [\w(]"), {"+": "-", "-": "+"}),
    ("product", re.compile(r"(?<!const )\b\w*[\w)\]] ([*/]) [\w(]"), {"*": "/", "/": "*"}),
    ("step", re.compile(r"[\w\])] (\+=|-=) "), {"+=": "-=", "-=": "+="}),
)
NUMBER = re.compile(r"(?<![\w.])(\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+|\d+)(?=[fF]?\b)(?![\w.]*x)")
STATEMENT = re.compile(r"^\s*(?!const\b|static\b|bool\b|return\b|real\b|int\b|typedef\b|enum\b|for\b)[\w>.\-\[\] *+]*?(?:=|\()[^{}]*;$")


def live_lines(source):
    """Numbers of the lines that this compiler reads: none that #if leaves out, no comment."""
    text = subprocess.run([*CC, *FLAGS, "-E", source], capture_output=True, text=True, check=True).stdout
    live, at, own = set(), 0, False
    for line in text.splitlines():
        if marker := re.match(r'# (\d+) "([^"]*)"', line):
            at, own = int(marker[1]), Path(marker[2]).name == source
        else:
            if own and line.strip():
                live.add(at)
            at += 1
    return live


def changes_of(line):
    """Kind and text of each changed line."""
    code = re.sub(r"/\*.*?\*/|/\*.*|\".*?\"", lambda found: " " * len(found[0]), line)
    for kind, pattern, into in CHANGES:
        for found in pattern.finditer(code):
            yield kind, line[: found.start(1)] + into[found[1]] + line[found.end(1) :]
    for found in NUMBER.finditer(code):
        text, whole = found[1], found[1].isdigit()
        other = str(int(text) + 1) if whole else "1.0" if float(text) == 0.0 else repr(float(text) * 1.25)
        yield "number", line[: found.start(1)] + other + line[found.end(1) :]
    if STATEMENT.match(code.rstrip()):
        yield "left out", re.match(r"\s*", line)[0] + ";"


def chosen(lines, live, rng):
    """One change of each line that has any: its number, the kind and the text."""
    for number, line in enumerate(lines, 1):
        possible = list(changes_of(line)) if number in live and not line.startswith("#") else []
        if possible:
            yield (number, *rng.choice(possible))


def compiled(arguments, where):
    return subprocess.run([*CC, *FLAGS, *arguments], cwd=where, capture_output=True, check=False).returncode == 0


def noticed(work, source, programs):
    """How a changed source is noticed: "killed", "does not compile" or ""."""
    objects = [f"{Path(other).stem}.o" for other in SOURCES if other != source]
    if not compiled(["-O0", "-c", source, "-o", "changed.o"], work):
        return "does not compile"
    for program in programs:
        if not compiled([f"{program}.o", "changed.o", *objects, "-lm", "-o", "program"], work):
            return "does not compile"
        try:
            if subprocess.run(["./program"], cwd=work, capture_output=True, timeout=20, check=False).returncode != 0:
                return "killed"
        except subprocess.TimeoutExpired:
            return "killed"
    return ""


def same_code(work, source, whole):
    """Whether the optimising compiler makes the same of both."""
    (work / "whole").mkdir(exist_ok=True)
    (work / "whole" / source).write_text(whole)
    both = [place / "same.o" for place in (work, work / "whole")]
    flags = ["-O2", "-I", str(work), "-c", source, "-o", "same.o"]
    return all(compiled(flags, one.parent) for one in both) and both[0].read_bytes() == both[1].read_bytes()


def tried(source, most, seed):
    """Counts by how they ended, and the lines of those that survive."""
    here, programs = Path(__file__).resolve().parent, SOURCES[source]
    whole = (here / source).read_text()
    lines, counts, left = whole.splitlines(), {}, []
    rng = random.Random(seed)
    mutants = list(chosen(lines, live_lines(source), rng))
    mutants = sorted(rng.sample(mutants, most)) if 0 < most < len(mutants) else mutants
    with tempfile.TemporaryDirectory() as place:
        work = Path(place)
        for file in here.glob("*.[ch]"):
            (work / file.name).write_bytes(file.read_bytes())
        for file in {*SOURCES, *(f"{program}.c" for program in programs)}:
            assert compiled(["-O1", "-c", file, "-o", f"{Path(file).stem}.o"], work), file
        if ended := noticed(work, source, programs):
            sys.exit(f"{source} as it is: {ended}")
        for number, kind, text in mutants:
            changed = [*lines[: number - 1], text, *lines[number:]]
            (work / source).write_text("\n".join(changed) + "\n")
            ended = noticed(work, source, programs) or ("same code" if same_code(work, source, whole) else "survived")
            counts[ended] = counts.get(ended, 0) + 1
            if ended == "survived":
                left.append(f"{source}:{number}: {kind}\n  - {lines[number - 1].strip()}\n  + {text.strip()}\n")
    return counts, left


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--most", type=int, default=200, help="changes of each source, drawn by --seed; 0: every line")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    os.chdir(Path(__file__).resolve().parent)
    everything, enough = [], True
    for source in SOURCES:
        counts, left = tried(source, options.most, options.seed)
        killed, survived = counts.get("killed", 0), counts.get("survived", 0)
        share = 100.0 * killed / max(1, killed + survived)
        print(f"{source}: {killed} of {killed + survived} changes noticed, {share:.1f} %; besides", end=" ")
        print(f"{counts.get('same code', 0)} of the same machine code, {counts.get('does not compile', 0)} not compiled")
        everything += left
        enough = enough and share >= 95.0
    Path("mutants.txt").write_text("".join(everything))
    print(f"survivors: mutants.txt, {len(everything)}")
    return 0 if enough else 1


if __name__ == "__main__":
    sys.exit(main())
