"""The house itself: its floors, its locks, its texts."""

from __future__ import annotations

import ast
import importlib
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

from flexhinf.plant.instruments import SENSORS
from flexhinf.robot.drives import DRIVES

MACHINE = re.compile(r"(?:^|[^A-Za-z0-9_.])/(?:home|root|work|Users|farm|mnt|opt)/", re.MULTILINE)


def texts(repository: Path) -> list[Path]:
    """The repository's own files: what is tracked, or everything where there is no git."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"],
        cwd=repository,
        capture_output=True,
        text=True,
        check=False,
    )
    if listed.returncode == 0:
        found = [repository / name for name in listed.stdout.split("\0") if name]
    else:
        parts = ("src", "tests", "docs", "benchmarks", "fuzz", "examples", ".ci")
        found = [file for part in parts for file in (repository / part).rglob("*")]
        found += list(repository.iterdir())
    return [file for file in found if file.is_file() and b"\0" not in file.read_bytes()[:4096]]


def lint_imports(root: Path) -> subprocess.CompletedProcess[str]:
    script = "import sys; from importlinter.cli import lint_imports_command; lint_imports_command()"
    return subprocess.run(
        [sys.executable, "-c", script, "--no-logo", "--no-cache"],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root / "src")},
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_contract_catches_what_it_is_there_for(repository: Path, tmp_path: Path) -> None:
    """A file of no floor, and imports of a floor above by a file and by a room."""
    shutil.copytree(repository / "src", tmp_path / "src", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(repository / "pyproject.toml", tmp_path)
    upwards = {"errors.py": "report", "hinf/__init__.py": "robot"}
    for file, room in upwards.items():
        (tmp_path / "src" / "flexhinf" / file).write_text(f"import flexhinf.{room}\n", encoding="utf-8")
    outcome = lint_imports(tmp_path)
    assert outcome.returncode == 1
    for complaint in ("flexhinf.errors -> flexhinf.report", "flexhinf.hinf -> flexhinf.robot"):
        assert complaint in outcome.stdout
    (tmp_path / "src" / "flexhinf" / "utils.py").write_text("", encoding="utf-8")
    outcome = lint_imports(tmp_path)
    assert outcome.returncode == 1
    assert "flexhinf.utils" in outcome.stdout


#: What loads a module of the package by its name, which the contract does not see: file and module. A room above or
#: beside is loaded when a method is called.
LOADED_BY_NAME = {
    ("__init__.py", "flexhinf.pages.name"),  # the package itself: what registers itself with a `Drawer`
    ("extensions.py", "package"),  # of a registry, with its files
    ("extensions.py", "package.name"),
    ("cli/messages.py", "flexhinf.cli.options"),  # the help of all commands takes no declaration of an option
    ("cli/messages.py", "flexhinf.designs.specification"),
    ("loop/controller/laws.py", "flexhinf.estimation"),  # the estimators that a file of a controller names
}


def loaded_by_name(nodes: list[ast.AST], package: str) -> set[str]:
    """The modules that a file gives to `import_module`: as texts, names of constants, or an argument's name; and those
    of the package that it gives to `late_package`."""
    named = {"__name__": package}
    for node in nodes[0].body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant):
            named |= {target.id: node.value.value for target in node.targets if isinstance(target, ast.Name)}

    def text_of(node: ast.expr) -> str:
        if isinstance(node, ast.JoinedStr):
            return "".join(map(text_of, node.values))
        if isinstance(node, ast.FormattedValue):
            return text_of(node.value)
        return node.value if isinstance(node, ast.Constant) else named.get(node.id, node.id)

    def given_to(*functions: str) -> set[str]:
        return {
            text_of(node.args[0])
            for node in nodes
            if isinstance(node, ast.Call)
            and getattr(node.func, "id", getattr(node.func, "attr", "")) in functions
        }

    late = {name for name in given_to("late_package") if name.startswith(package)}
    return given_to("import_module", "__import__") | late


def test_modules_loaded_by_name_are_listed(repository: Path, sources: dict[Path, list[ast.AST]]) -> None:
    package = repository / "src" / "flexhinf"
    found = {
        (file.relative_to(package).as_posix(), name)
        for file, nodes in sources.items()
        for name in loaded_by_name(nodes, "flexhinf")
    }
    libraries = {
        ("robot/mujoco.py", "mujoco"),
        ("robot/mujoco.py", "mujoco.viewer"),
        ("processors.py", "scipy.linalg"),
        ("validation.py", "package"),  # `optional_package`: its argument
    }
    assert found == LOADED_BY_NAME | libraries


#: Where pages take classes and constants alone: what is solved, searched for or checked is a result by then.
COMPUTE = (
    "analysis", "certify", "codegen", "estimation", "hinf", "modal", "designs.proved_step", "designs.synthesis",
    "designs.workspace.design", "designs.workspace.pair_proof", "designs.workspace.proof",
    "designs.workspace.robustness",
    "designs.workspace.search",
)  # fmt: skip

#: Functions of these that pages may call: texts, a unit, sums of a few numbers, a part of a result.
READS = {
    "common_unit", "modal_filter", "motors_alone", "of_controller", "persistent_bound", "proved_errors", "shrinking",
    "theorem_parts", "verification_text",
}  # fmt: skip


def test_pages_compute_nothing(repository: Path, sources: dict[Path, list[ast.AST]]) -> None:
    """They import no function of a solver, a search or a checker, nor a whole file of these, nor the whole package."""
    pages = repository / "src" / "flexhinf" / "pages"
    nodes = [node for file, tree in sources.items() if pages in file.parents for node in tree]
    imports = [node for node in nodes if isinstance(node, ast.ImportFrom)]
    whole = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    taken = {
        alias.name
        for node in imports
        if f"{node.module}.".startswith(tuple(f"flexhinf.{room}." for room in COMPUTE))
        for alias in node.names
    }
    assert len(taken) > 20
    assert {name for name in taken if name[0].islower()} == READS
    rooms = {room.partition(".")[0] for room in COMPUTE}
    assert {a.name for node in imports if node.module == "flexhinf" for a in node.names} & rooms == set()
    assert {name for name in whole if name.startswith("flexhinf")} == set()


#: Where a torque of springs is something else than what a sensor measures: a penalty, what a law's proponents measure,
#: and a line of a page.
NO_SENSOR = {"robot/signals.py", "designs/laws/kinds.py", "pages/drawing.py", "pages/design/weights.py"}


def named_in(repository: Path, sources: dict[Path, list[ast.AST]], name: str) -> set[str]:
    """Files of the package with a text that is this name, or begins the name of a joint's signal."""
    package = repository / "src" / "flexhinf"
    return {
        str(file.relative_to(package))
        for file, nodes in sources.items()
        if any(isinstance(node, ast.Constant) and node.value in (name, f"{name}_") for node in nodes)
    }


def test_what_differs_between_sensors_and_drives_stands_in_their_kinds(
    repository: Path, sources: dict[Path, list[ast.AST]]
) -> None:
    """A sensor or a drive more is a file more: no other one names it, but for the plant of the paper, whose input is a
    voltage. Positions and velocities are states of plants too, which have their names."""
    for drive in DRIVES.values():
        assert named_in(repository, sources, drive.quantity) - {"pages/paper.py"} == {"robot/drives/kinds.py"}
    sensors = [name for name, kind in SENSORS.items() if kind.of_springs]
    assert len(sensors) > 1
    for name in sensors:
        assert named_in(repository, sources, name) - NO_SENSOR == {"plant/instruments/kinds.py"}


def compared_drives(nodes: list[ast.AST]) -> list[int]:
    """Lines that compare a drive of a robot with texts, or look up something by one."""
    found = []
    for node in nodes:
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
        elif isinstance(node, ast.Subscript) and isinstance(node.value, ast.Dict):
            sides = [node.slice, *filter(None, node.value.keys)]
        else:
            continue
        drives = any(ast.unparse(side).endswith((".drive", "drive")) for side in sides)
        inner = (text for side in sides for text in ast.walk(side) if isinstance(text, ast.Constant))
        if drives and any(isinstance(text.value, str) for text in inner):
            found.append(node.lineno)
    return found


def test_nobody_asks_for_the_name_of_a_drive(repository: Path, sources: dict[Path, list[ast.AST]]) -> None:
    """A property of its kind is read instead. How a stop commands an input is named `drive` in `Protection`."""
    stops = ("loop/controller/protection.py", "loop/controller/stop.py", "export/stop_code.py")
    found = {str(file): lines for file, nodes in sources.items() if (lines := compared_drives(nodes))}
    assert len(found) == len(stops)  # the rule finds something
    assert all(file.endswith(stops) for file in found), found
    planted = ast.parse(
        "a = robot.drive == 'position'\nb = {'torque': 1.0}[self.drive]\nc = drive in ('x', 'y')"
    )
    assert compared_drives([*ast.walk(planted)]) == [1, 2, 3]


def test_a_lazy_room_names_its_own_files_only(repository: Path) -> None:
    """The names of a stub are loaded on first use; the contract does not read stubs."""
    stubs = sorted((repository / "src" / "flexhinf").rglob("__init__.pyi"))
    assert len(stubs) >= 3
    for stub in stubs:
        nodes = ast.walk(ast.parse(stub.read_text(encoding="utf-8")))
        parts = [node for node in nodes if isinstance(node, (ast.Import, ast.ImportFrom))]
        assert {getattr(node, "level", 0) for node in parts if "__future__" not in ast.dump(node)} == {1}


def test_no_text_names_a_path_of_somebodys_machine(repository: Path) -> None:
    found = {
        str(file.relative_to(repository)): match.group()
        for file in texts(repository)
        if file.suffix != ".svg" and (match := MACHINE.search(file.read_text(encoding="utf-8")))
    }
    assert found == {}


#: Files whose one concept is longer: none.
LONG: tuple[str, ...] = ()


def test_a_file_is_one_concept_of_at_most_600_lines(repository: Path) -> None:
    python = [file for file in texts(repository) if file.suffix == ".py"]
    lengths = {str(file): len(file.read_text(encoding="utf-8").splitlines()) for file in python}
    assert len(lengths) > 20
    assert {
        name: length for name, length in lengths.items() if length > 600 and not name.endswith(LONG)
    } == {}


def test_every_test_directory_mirrors_a_room(repository: Path) -> None:
    rooms = {path.name for path in (repository / "src" / "flexhinf").iterdir()}
    mirrored = {path.name for path in (repository / "tests").iterdir() if path.is_dir()} - {"__pycache__"}
    assert mirrored <= rooms | {"benchmarks", "docs", "examples"}


def test_locks_hold_hashes_and_no_address_and_agree(repository: Path) -> None:
    pins = {}
    for name in ("requirements.lock", "requirements-dev.lock"):
        text = (repository / name).read_text(encoding="utf-8")
        assert "://" not in text
        assert "index-url" not in text
        pinned = re.findall(r"^(\S+==\S+)((?: ; [^\\\n]*)?) \\\n    --hash=sha256:", text, re.MULTILINE)
        lines = [line for line in text.splitlines() if line and not line.startswith((" ", "#"))]
        assert len(pinned) == len(lines)
        pins[name] = {pin for pin, _ in pinned}
    assert pins["requirements.lock"] <= pins["requirements-dev.lock"]
    assert any(pin.startswith("flit-core==") for pin in pins["requirements.lock"])


def test_locks_hold_everything_the_project_asks_for(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))["project"]

    def name_of(requirement: str) -> str:
        return re.split(r"[^A-Za-z0-9_.-]", requirement)[0].lower().replace("_", "-")

    run = (repository / "requirements.lock").read_text(encoding="utf-8")
    dev = (repository / "requirements-dev.lock").read_text(encoding="utf-8")
    assert [r for r in project["dependencies"] if f"\n{name_of(r)}==" not in f"\n{run}"] == []
    assert [
        r for r in project["optional-dependencies"]["test"] if f"\n{name_of(r)}==" not in f"\n{dev}"
    ] == []


def test_every_key_cited_is_in_the_references(repository: Path, sources: dict[Path, list[ast.AST]]) -> None:
    bibliography = (repository / "docs" / "references.bib").read_text(encoding="utf-8")
    known = re.findall(r"^@\w+\{(\w+),", bibliography, re.MULTILINE)
    assert sorted(known) == sorted(set(known))
    cited: dict[str, str] = {}
    for file, nodes in sources.items():
        for node in nodes:
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
                keys = re.findall(r"\[([a-z]+(?:19|20)\d\d[a-z]?)\]", ast.get_docstring(node) or "")
                cited.update(dict.fromkeys(keys, str(file)))
    assert cited
    assert {key: file for key, file in cited.items() if key not in known} == {}


def test_importing_the_package_loads_no_heavy_library() -> None:
    heavy = ("scipy", "casadi", "llvmlite", "matplotlib", "xarray", "typer")
    code = f"import sys, flexhinf; print([name for name in {heavy!r} if name in sys.modules])"
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert outcome.stdout.strip() == "[]"


def test_every_public_name_can_be_imported() -> None:
    import flexhinf as fh

    # What synthesis, loops and their extensions need.
    promised = [
        "paper_arm",
        "Plant",
        "PolynomialPlant",
        "smallest_gamma",
        "solve_hji",
        "linear_law",
        "load_solution",
        "HJISolution",
        "InfeasibleGamma",
        "UnscentedKalmanFilter",
        "ExtendedKalmanFilter",
        "Controller",
        "Loop",
        "Trajectory",
        "load_controller",
        "Step",
        "Sine",
        "Quintic",
        "Samples",
        "Law",
        "Estimator",
        "Gaussian",
        "BlackBox",
        "Penalty",
        "Certificate",
        "load_certificate",
        "NotStabilisable",
        "NotDetectable",
    ]
    missing = [name for name in promised if not hasattr(fh, name) or name not in fh.__all__]
    assert missing == []
    assert [name for name in fh.__all__ if not hasattr(fh, name)] == []


def test_every_name_of_a_lazy_room_can_be_imported(repository: Path) -> None:
    """`lazy_loader` reads the stubs; a name whose file moved would be missed on first use only."""
    stubs = sorted((repository / "src" / "flexhinf").rglob("__init__.pyi"))
    assert len(stubs) >= 3
    for stub in stubs:
        parts = stub.parent.relative_to(repository / "src").parts
        room = importlib.import_module(".".join(parts))
        assert [name for name in room.__all__ if not hasattr(room, name)] == []


#: Words that a control engineer would not say: no name in `src` has one as a part. The noun stands there instead.
RIDDLES = {
    "asked", "bench", "blow", "carried", "carrying", "continued", "corridor", "covered", "covering", "dial",
    "disturbed", "drawn", "endless", "expense", "face", "fade", "found", "game", "given", "grip", "gripped", "gripping",
    "held", "hold", "hunting", "knob", "laned", "least", "made", "maker", "march", "marching", "merits", "met", "one",
    "ours", "pace", "reading", "remembered", "rest", "running", "sag", "shown", "side", "spending", "steering",
    "struck", "told", "untrusted", "ways", "withstand", "words", "yardstick",
}  # fmt: skip

#: Names that have such a word, because there it is the field's.
TERMS = {
    # The number 1, and what has exactly one.
    "AboveOne", "ONE_OPERAND", "ONE_TRACE", "_contract_one_index", "one", "one_of", "one_or_several",
    "one_period", "ones", "ones_like",
    # At least, a lower limit; the least damped mode; the least value of a polynomial on a cell; least squares.
    "_AtLeast", "at_least", "least_damped", "least_damped_joint", "least_growth", "least_squares", "least_value",
    "least",  # whether small values are the bad ones: a key of a file of a worst case
    "found",  # the second part of every error, and a key of result files
    "met", "not_met", "NOT_MET", "run_met",  # the status of a requirement
    # The faces of a cube; the link side and the motor side of a spring, and both sides of an interval.
    "Face", "_face", "_on_face", "face", "faces", "subdivide_face", "_side", "side",
    # What a zero-order hold holds, and the input that holds a load against gravity.
    "HELD", "HOLD", "ZeroOrderHold", "_held", "_hold", "first_order_hold", "held", "hold", "hold_command",
    "hold_inputs",
    "rests", "_RestToRest",  # a robot at rest, and a motion from rest to rest
    "DISTURBED", "disturbed",  # a plant and a loop with their disturbance
    "rest", "_twists_at_rest", "at_rest", "flexhinf_at_rest", "Readings", "_readings", "readings", "believed_readings",
    "first_readings", "reading_steps", "reading_windows",  # what stands still, and what an encoder reads
    "FileNotFoundError", "ModuleNotFoundError", "PackageNotFoundError", "is_running",  # of Python, MuJoCo's viewer
}  # fmt: skip


def identifiers(nodes: list[ast.AST]) -> set[str]:
    """Every name that a file makes or uses: of classes, functions, arguments, variables and fields."""
    found = set()
    for node in nodes:
        field = NAMED.get(type(node))
        if field is not None and (name := getattr(node, field)):
            found.add(name)
    return found


NAMED = {
    ast.Name: "id", ast.ClassDef: "name", ast.FunctionDef: "name", ast.arg: "arg", ast.Attribute: "attr",
    ast.keyword: "arg", ast.alias: "asname",
}  # fmt: skip


def test_names_are_terms_of_the_field(repository: Path, sources: dict[Path, list[ast.AST]]) -> None:
    found = {}
    for file, nodes in sources.items():
        names = {file.stem, *identifiers(nodes)}
        for name in names:
            parts = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower().split("_")
            if {form for part in parts for form in (part, part.removesuffix("s"))} & RIDDLES:
                found.setdefault(name, str(file.relative_to(repository)))
    assert {name: file for name, file in found.items() if name not in TERMS} == {}
    assert set(found) >= TERMS


def test_no_value_is_read_for_a_side_effect(repository: Path, sources: dict[Path, list[ast.AST]]) -> None:
    """A property that checks or compiles is a method with a verb; nothing reads a value and drops it."""
    found = []
    for file, nodes in sources.items():
        for node in nodes:
            bare = isinstance(node, ast.Expr) and isinstance(
                node.value, (ast.Attribute, ast.Name, ast.Subscript)
            )
            dropped = (
                isinstance(node, ast.Assign)
                and isinstance(node.value, ast.Attribute)
                and all(isinstance(target, ast.Name) and target.id == "_" for target in node.targets)
            )
            if bare or dropped:
                found.append(f"{file.relative_to(repository)}:{node.lineno}")
    assert found == []


#: Methods that may write into a frozen object: its construction, and what that calls.
CONSTRUCTION = {"__init__", "__post_init__", "__setstate__", "_check_curve", "_check_drive", "_equilibrium"}


def test_a_frozen_object_is_written_by_its_construction_alone(
    repository: Path, sources: dict[Path, list[ast.AST]]
) -> None:
    """What it keeps for the next call is a cached property; changing that is no write into the object."""
    classes = [node for nodes in sources.values() for node in nodes if isinstance(node, ast.ClassDef)]
    frozen = [kind for kind in classes if any("frozen=True" in ast.unparse(d) for d in kind.decorator_list)]
    assert len(frozen) > 50
    writers = {
        method.name
        for kind in frozen
        for method in kind.body
        if isinstance(method, ast.FunctionDef)
        and re.search(
            r"object\.__setattr__\(self,|(vars\(self\)|self\.__dict__)(\[[^]]+\] = |\.update\()",
            ast.unparse(method),
        )
    }
    assert writers == CONSTRUCTION


def test_a_refusal_is_a_block_that_is_entered(repository: Path) -> None:
    """`refused_with(...)` alone makes a block and enters none: a test that cannot fail."""
    files = {file: file.read_text(encoding="utf-8") for file in (repository / "tests").rglob("*.py")}
    begins = re.compile(r"^\s*refused_with\(", re.MULTILINE)
    found = [
        f"{file.name}:{node.lineno}"
        for file, text in files.items()
        if begins.search(text)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Call)
        and getattr(node.value.func, "id", "") == "refused_with"
    ]
    assert found == []


def test_no_message_names_a_page_of_the_documentation_by_its_file(sources: dict[Path, list[ast.AST]]) -> None:
    """Who installed a wheel has no folder docs: its title finds it."""
    for file, nodes in sources.items():
        notes = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        said = [node for node in nodes if isinstance(node, ast.Constant) and id(node) not in notes]
        assert not [node.value for node in said if re.search(r"docs/\w+\.md", str(node.value))], file


#: Names of libraries in the figures of rooms.
LIBRARIES = {"NumPy", "CasADi", "WebAssembly"}

#: What divides the steps of a figure: lines with arrows, spaces, commas.
BETWEEN = re.compile(r"[─►◄▲▼│┌┐└┘├┤┬┴┼]+|  +|[\n,:]")


def names_in(room: Path, sources: dict[Path, list[ast.AST]]) -> set[str]:
    """What the docstring of a room may name: rooms, its own files with what these define, and classes of any room."""
    names = {entry.stem for entry in room.parent.iterdir()}
    for file, nodes in sources.items():
        own = room in file.parents
        path = file.relative_to(room.parent.parent).with_suffix("").parts
        path = path[:-1] if file.stem == "__init__" else path
        paths = {".".join(path[start:]) for start in range(len(path) if own else 2)}
        definitions = (ast.ClassDef, ast.FunctionDef)
        defined = {node.name for node in nodes[0].body if isinstance(node, definitions)}
        names |= paths
        names |= {f"{end}.{name}" for end in paths | {".".join(path[:2])} for name in defined}
        names |= {name for name in defined if own or name[0].isupper()}
    return names


def test_a_room_begins_with_a_figure_whose_names_exist(
    repository: Path, sources: dict[Path, list[ast.AST]]
) -> None:
    """A sentence, a figure of what flows through its files, and where to enter; no package in it is left out."""
    packages = [file.parent for file in sources if file.name == "__init__.py"]
    rooms = [package for package in packages if package.parent == repository / "src" / "flexhinf"]
    assert len(rooms) > 20
    for room in rooms:
        text = ast.get_docstring(sources[room / "__init__.py"][0]) or ""
        first, _, rest = text.partition("\n\n")
        figure = rest.partition("::\n\n")[2].partition("\n\n")[0]
        assert " and " not in first.partition(". ")[0], room.name
        assert figure.count("─►") >= 3, room.name
        steps = {step.strip() for step in BETWEEN.split(figure)}
        named = {name.rstrip("/") for name in re.findall(r"(?<!`)`([^`\n]+)`(?!`)", text)}
        named |= {step for step in steps if re.fullmatch(r"[a-z_0-9.]+|[A-Z]\w*[a-z]\w*", step)}
        named |= set(re.findall(r"\b[A-Z][a-z]\w*[A-Z]\w*", figure))
        assert named - LIBRARIES - names_in(room, sources) == set(), room.name
        inner = {package.name for package in packages if package.parent == room}
        assert inner <= set(re.findall(r"\w+", text)), room.name
