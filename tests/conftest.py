"""Settings of all tests: hypothesis draws the same examples every time and knows no deadline."""

from __future__ import annotations

import ast
import gc
import importlib
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from cProfile import Profile
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from _pytest.doctest import DoctestModule
from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture import providers
from tests.browser import browser  # noqa: F401 - a fixture of all rooms
from tests.costs import Costs

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(
        _name, "1"
    )  # small matrices: more threads only cost, and tests already run side by side

# Whoever starts the tests in the background may have signals ignored, which commands keep.
for _signal, _way in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(_signal) == signal.SIG_IGN:
        signal.signal(_signal, _way)

settings.register_profile(
    "flexhinf",
    derandomize=True,
    deadline=None,
    max_examples=50,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("thorough", parent=settings.get_profile("flexhinf"), max_examples=1000)
settings.load_profile(os.environ.get("FLEXHINF_HYPOTHESIS", "flexhinf"))
# Else it reads the constants of every module that a worker happens to have loaded: 4 CPU s, and other examples in
# another order of the tests.
providers.is_local_module_file = lambda path: False


#: A cart on a soft belt carries an arm: one joint slides, one turns, and their inputs are a force and a torque.
CART = """
name = "cart"
gravity = { value = 9.81 }
down = [0.0, 0.0, -1.0]
home = [0.0, 0.3]

[[joint]]
name = "belt"
kind = "prismatic"
axis = [1.0, 0.0, 0.0]
limits = [-0.5, 0.5]
spring = { stiffness = { value = 6.0e3, tolerance = 12 } }
motor = { motor_inertia = { value = 2.5, tolerance = 3 }, friction = { value = 40.0, tolerance = 15 } }

[joint.link]
mass = { value = 4.0, tolerance = 5 }
centre_of_mass = { value = [0.0, 0.0, 0.0] }
inertia = { xx = 0.02, yy = 0.02, zz = 0.02 }

[[joint]]
name = "arm"
axis = [0.0, 1.0, 0.0]
limits = [-2.5, 2.5]

[joint.link]
mass = { value = 1.2, tolerance = 5 }
centre_of_mass = { value = [0.0, 0.0, -0.3] }
inertia = { xx = 0.01, yy = 0.011, zz = 0.001 }

[joint.spring]
stiffness = { value = 90.0, tolerance = 12 }

[joint.motor]
motor_inertia = { value = 0.08, tolerance = 3 }
friction = { value = 0.4, tolerance = 15 }
"""


#: What files share, and which ones they are.
TOGETHER = {
    "designs of reports": r"tests/pages/",
    "sources, parsed": r"tests/test_(house|circles)\.py",
    "a proof for all tolerances": r"tests/certify/test_(attained_gain|checked_arm)\.py",
    "packages for ROS 2": r"tests/export/test_ros2(_chained|_trajectories)?\.py",
}


@pytest.fixture(scope="session")
def robot_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Any]:
    """A robot by name: of the catalogue, or ours. "paper stiffness*0.3" is the arm with a softer spring."""
    import flexhinf as fh

    file = tmp_path_factory.mktemp("robots") / "cart.toml"
    file.write_text(CART, encoding="utf-8")
    known: dict[str, Any] = {}

    def named(name: str) -> Any:
        if name not in known:
            base, *changes = name.split()
            robot = fh.load_robot(file if base == "cart" else base)
            for change in changes:
                quantity, factor = change.split("*")
                values = {
                    p.name: p.value * float(factor) for p in robot.parameters if p.name.startswith(quantity)
                }
                assert values
                robot = robot.with_values(values)
            known[name] = robot
        return known[name]

    return named


@pytest.fixture(scope="session")
def only_uncertain() -> Callable[..., Any]:
    """The robot with the tolerances of the parameters of these names alone."""

    def of(robot: Any, *names: str) -> Any:
        kept = [p if p.name in names else replace(p, tolerance=0.0) for p in robot.parameters]
        return replace(robot, parameters=tuple(kept))

    return of


@pytest.fixture(scope="session")
def repository() -> Path:
    """The folder that holds pyproject.toml."""
    return Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def website(repository: Path) -> Callable[[str], Any]:
    """Import a module of docs/website, which is no package of the project, by its name."""

    def imported(name: str) -> Any:
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend(str(repository / "docs"))
            return importlib.import_module(f"website.{name}")

    return imported


@pytest.fixture(scope="session")
def sources(repository: Path) -> dict[Path, list[ast.AST]]:
    """Every Python file of the package as the nodes of its tree, of which the first is the module; walked once."""
    files = sorted((repository / "src" / "flexhinf").rglob("*.py"))
    gc.disable()
    try:
        return {file: list(ast.walk(ast.parse(file.read_text(encoding="utf-8")))) for file in files}
    finally:
        gc.freeze()  # they stay, and are not looked through for garbage
        gc.enable()


#: What compilers and linkers say where a flag, a header or a library is not there; and how a program ends whose
#: instructions the processor lacks.
ABSENT = re.compile(
    r"un(?:recognized|known|supported)[ \w-]*(?:option|argument|value)|not supported|bad value|"
    r"fatal error: .*(?:No such file|not found)|cannot find|unable to find library|No such file or directory"
)
LACKS_AN_INSTRUCTION = -signal.SIGILL


@cache
def what_is_missing(compiler: str, flags: tuple[str, ...]) -> str:
    """What is not there to build a program with these flags and run it; empty where all is.

    A compiler that fails otherwise, and a program of it that does not run, fail the test: they are not missing.
    """
    found = shutil.which(compiler)
    if found is None:
        return f"missing: {compiler}"
    with TemporaryDirectory() as work:
        (Path(work) / "probe.c").write_text(
            '#include <math.h>\n#include <stdio.h>\nint main(void) { return printf("%d", 1) != 1; }\n'
        )
        for words in ([found, *flags, "probe.c", "-lm", "-o", "probe"], ["./probe"]):
            done = subprocess.run(words, cwd=work, capture_output=True, text=True, check=False)
            said = " ".join(done.stderr.split()) or f"exit code {done.returncode}"
            built = words[0] == "./probe"
            if done.returncode == LACKS_AN_INSTRUCTION if built else done.returncode and ABSENT.search(said):
                return f"missing: what {compiler} {' '.join(flags)} needs here: {said[:200]}"
            assert done.returncode == 0, f"{' '.join(words)}: {said[:2000]}"
    return ""


@pytest.fixture(scope="session")
def needs_compiler() -> Callable[..., None]:
    """Skips, with the reason, where a compiler is missing, or what it needs for these flags."""

    def needed(compiler: str, *flags: str) -> None:
        if reason := what_is_missing(compiler, flags):
            pytest.skip(reason)

    return needed


@pytest.fixture
def bounded_work() -> Callable[[int], AbstractContextManager[None]]:
    """A context with at most so many calls of Python and C functions: a bound that no busy machine breaks."""

    @contextmanager
    def bounded(most: int) -> Iterator[None]:
        profile = Profile()
        profile.enable()
        try:
            yield
        finally:
            profile.disable()
            calls = sum(entry.callcount for entry in profile.getstats())
            assert calls <= most, f"{calls} calls"

    return bounded


@pytest.fixture(scope="module")
def unoptimised() -> Iterator[None]:
    """Machine code and C of this file's tests are not optimised: a setting of the product, which changes no bit.

    A file asks for it by ``pytestmark = pytest.mark.usefixtures("unoptimised")``, and says what that saves. It pays
    where what is compiled runs once.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FLEXHINF_OPTIMISATION", "0")
        yield


@pytest.fixture(scope="session", autouse=True)
def shared_by_workers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """All workers of a run share the store of commands and, in it, machine code; both begin empty."""
    run = tmp_path_factory.getbasetemp()
    run = run.parent if "PYTEST_XDIST_WORKER" in os.environ else run
    with pytest.MonkeyPatch.context() as patch:
        store = os.environ.get("FLEXHINF_TEST_STORE", str(run / "store"))
        patch.setenv("FLEXHINF_TEST_STORE", store)
        patch.setenv("FLEXHINF_CACHE", str(Path(store).absolute() / "kernels"))
        patch.delenv("FLEXHINF_OPTIMISATION", raising=False)
        yield


def _later_cases(items: list[pytest.Item]) -> Iterator[pytest.Item]:
    """Of each test that is marked `quick_cases(number)`: the cases beyond that number, the quick ones spread evenly."""
    cases: dict[str, list[pytest.Item]] = {}
    for item in items:
        later = any(item.get_closest_marker(tier) for tier in ("ci", "nightly"))
        if item.get_closest_marker("quick_cases") is not None and not later:
            cases.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for of_test in cases.values():
        number = of_test[0].get_closest_marker("quick_cases").args[0]
        quick = {round(k * len(of_test) / number) for k in range(number)}
        yield from (item for place, item in enumerate(of_test) if place not in quick)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """What is collected stays: it is not looked through again and again for garbage."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()
        gc.set_threshold(20_000, *gc.get_threshold()[1:])  # tests make many objects and few circles of them


#: A file whose tests are all of a later tier.
_LATER = re.compile(r"^pytestmark = [^\n]*mark\.(ci|nightly)\b", re.MULTILINE)

#: The selections of `make test`, `make ci` and `make nightly`.
QUICK, CI, NIGHTLY = "not ci and not nightly", "ci and not nightly", "nightly"


def _has_none(file: Path, tier: str) -> bool:
    """Whether a file of tests has none of the tier that is asked for, as its text shows."""
    text = file.read_text(encoding="utf-8")
    if tier == QUICK:
        return _LATER.search(text) is not None
    if tier in (CI, NIGHTLY) and "ci_and_night" in text:
        return False
    if tier == CI:
        return "mark.ci" not in text and "quick_cases" not in text
    return tier == NIGHTLY and "mark.nightly" not in text


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Files without a test of the tier that is asked for are not imported."""
    is_test = collection_path.suffix == ".py" and collection_path.name.startswith("test_")
    return True if is_test and _has_none(collection_path, config.option.markexpr) else None


@pytest.hookimpl(wrapper=True)
def pytest_collect_file() -> Iterator[Any]:
    """Tests have no examples in their docstrings: they are not searched for them."""
    return [found for found in (yield) if not isinstance(found, DoctestModule)]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Files that share what takes long to make run in one worker, one after the other."""
    if config.getvalue("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Sharing(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            return next((shared for shared, files in TOGETHER.items() if re.match(files, file)), file)

    return Sharing(config, log)


def pytest_configure(config: pytest.Config) -> None:
    """Register what adds up costs. Every other worker collects from the end.

    In a new clone pytest writes code for each test file, which is most of the collection: so each worker finds half of
    it written.
    """
    config.pluginmanager.register(Costs(config), "flexhinf-costs")
    worker = os.environ.get("PYTEST_XDIST_WORKER", "gw0")
    if [Path(place).name for place in config.args] == ["tests", "src"] and int(worker.removeprefix("gw")) % 2:
        files = sorted((config.rootpath / "tests").rglob("test_*.py"), reverse=True)
        config.args = [*(str(file) for file in files if not _has_none(file, config.option.markexpr)), "src"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Cases beyond `quick_cases` are of `make ci`. All are sorted by file, since workers collect in other orders."""
    for item in _later_cases(items):
        item.add_marker(pytest.mark.ci("one more case of a test whose other cases are quick"))
    items.sort(key=lambda item: str(item.path))
