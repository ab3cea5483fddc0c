"""Programs that an export calls: one that fails is told from one that is not there."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.builders import arm_controller
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.export import compiled, export_c, safety
from flexhinf.export.controller_c import code_of
from flexhinf.export.programs import c_compiler
from flexhinf.export.stack import stack_bytes, stack_text, why_not

pytestmark = [pytest.mark.usefixtures("unoptimised"), pytest.mark.ci("exports with compilers that fail")]

#: Where a compiler stops, and what it says, of files with this word in their name.
STOPS = """#!/bin/sh
case "$*" in {pattern}) echo "internal error: {words}" >&2; exit 4;; esac
exec {compiler} "$@"
"""

#: A compiler whose programs of a controller end early.
ENDS_EARLY = r"""#!/bin/sh
{compiler} "$@" || exit 1
case "$*" in {pattern}) printf '#!/bin/sh\nexit 3\n' > built;; esac
"""

#: A compiler whose programs with sanitizers stop before they begin.
STOPS_WHEN_CHECKED = r"""#!/bin/sh
{compiler} "$@" || exit 1
case "$*" in *-fsanitize*probe.c*) printf '#!/bin/sh\necho own words >&2\nexit 1\n' > probe;; esac
"""

Program = Callable[..., Path]


@pytest.fixture
def program(tmp_path: Path, compiler: str) -> Program:
    """Writes a program of a name into a folder of its own: by default a C compiler that stops at some arguments."""

    def written(
        name: str, text: str = STOPS, pattern: str = "*arm*|*controller*", words: str = "cannot"
    ) -> Path:
        place = tmp_path / "programs" / name
        place.parent.mkdir(exist_ok=True)
        place.write_text(text.format(pattern=pattern, words=words, compiler=compiler), encoding="utf-8")
        place.chmod(0o755)
        return place

    return written


@pytest.fixture
def only_programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The PATH has the folder of `program` alone."""
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path / "programs"))


@pytest.fixture(scope="module")
def small() -> fh.Controller:
    return arm_controller(kind=None)


def readme(small: fh.Controller, folder: Path, real: str = "float") -> str:
    return (export_c(small, folder, "arm", real) / "README.md").read_text(encoding="utf-8")


def test_a_compiler_that_fails_on_the_controller_is_an_error_of_an_export_in_float(
    small: fh.Controller, program: Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its README said that no compiler was found."""
    monkeypatch.setenv("CC", str(program("failing-cc")))
    with refused_with(InvalidInput, "compile", "failing-cc", "internal error", 4):
        export_c(small, tmp_path / "c", "arm", "float")
    assert not (tmp_path / "c").exists()


def test_a_vector_that_ends_early_is_no_loss_in_float(
    small: fh.Controller, program: Program, compiler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by a compiler whose programs stop: the controller was said to lose too much."""
    monkeypatch.setenv("CC", str(program("stopping-cc", ENDS_EARLY)))
    with refused_with(InvalidInput, "end", "exit code 3"):
        export_c(small, tmp_path / "c", "arm", "float")


@pytest.mark.usefixtures("only_programs")
def test_where_there_is_no_compiler_the_readme_says_so(small: fh.Controller, tmp_path: Path) -> None:
    text = readme(small, tmp_path / "c")
    assert unnamed(text, "no C compiler", "not found", "gcc was", "arm-none-eabi-gcc was") == []


def test_a_compiler_for_another_machine_measures_nothing(
    small: fh.Controller, program: Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = '#!/bin/sh\nfor last; do :; done\necho none > "$last"\nchmod +x "$last"\n'
    monkeypatch.setenv("CC", str(program("other-cc", other)))
    assert unnamed(readme(small, tmp_path / "c"), "not measured", "other-cc") == []


def test_a_compiler_that_cc_names_is_not_another_one(
    small: fh.Controller, compiler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was replaced by the next that was found. CC may have flags."""
    monkeypatch.setenv("CC", "no-such-cc -O2")
    with refused_with(InvalidInput, "CC", "no-such-cc -O2"):
        fh.compile_controller(small, tmp_path / "arm.so")
    monkeypatch.setenv("CC", f"{compiler} -O1")
    assert c_compiler() == [compiler, "-O1"]
    assert fh.load_compiled(fh.compile_controller(small, tmp_path / "arm.so")).step([0.1] * 4).shape == (1,)


def test_a_compiler_that_fails_with_the_instructions_of_the_processor_is_an_error(
    small: fh.Controller, program: Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was taken for one that does not know them, and the library had other bits."""
    monkeypatch.setenv("CC", str(program("failing-cc", pattern="*-march*controller*")))
    with refused_with(InvalidInput, "failing-cc", "internal error"):
        fh.compile_controller(small, tmp_path / "arm.so")


# The stack and the size ---------------------------------------------------------------------------------
def test_a_stack_that_no_compiler_tells_is_said_with_why(
    small: fh.Controller, program: Program, only_programs: None
) -> None:
    files = code_of(small, "arm", "double").files
    program("gcc", pattern="*-fcallgraph-info*", words="unknown option")
    text = stack_text(files, "arm", "double")
    assert unnamed(text, "not computed", "arm-none-eabi-gcc", "not found", "unknown option") == []
    program("gcc", pattern="*-fcallgraph-info*arm.c*")
    with refused_with(InvalidInput, "compile", "internal error"):
        stack_text(files, "arm", "double")


@pytest.mark.usefixtures("only_programs")
def test_a_compiler_of_the_microcontroller_that_fails_is_not_missing(
    small: fh.Controller, program: Program
) -> None:
    """`--flash` was then compared with the constants alone."""
    code = code_of(small, "arm", "float")
    assert compiled.cortex_m4_bytes(code) is None
    for name in ("arm-none-eabi-gcc", "arm-none-eabi-size"):
        program(name, pattern="*", words="no newlib")
    with refused_with(InvalidInput, "Cortex-M4F", "no newlib", "--flash"):
        compiled.cortex_m4_bytes(code)


def test_what_a_compiler_tells_is_asked_once(compiler: str) -> None:
    if shutil.which("gcc") is None:
        pytest.skip("missing: gcc")
    assert unnamed(why_not("no-such-gcc", ()), "no-such-gcc", "not found") == []
    assert why_not("gcc", ("-O1",)) == ""
    files = {"a.c": "int one(int x) { return x; }"}
    assert stack_bytes(files, "one", "gcc", ("-O1",)) >= 0


def test_sanitizers_that_fail_are_not_missing(
    small: fh.Controller, program: Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`make mutants` then looked for less, and did not say so."""
    folder = export_c(small, tmp_path / "c", "arm")
    command = [sys.executable, "mutants.py", "--most", "1"]

    def ended(cc: Path, *more: str) -> subprocess.CompletedProcess[str]:
        monkeypatch.setenv("CC", str(cc))
        return subprocess.run([*command, *more], cwd=folder, capture_output=True, text=True, check=False)

    unknown = program("without-cc", pattern="*-fsanitize*", words="no such option")
    assert unnamed(ended(unknown).stdout, "without-cc", "lacks", "no such option") == []
    failing = program("failing-cc", STOPS_WHEN_CHECKED)
    done = ended(failing)
    assert done.returncode == 1
    assert unnamed(done.stderr, "-fsanitize=address,undefined", "own words", "--no-sanitizers") == []
    assert "changes noticed" in ended(failing, "--no-sanitizers").stdout


# The processor and the commit ---------------------------------------------------------------------------
def test_instructions_that_nobody_tells_are_not_missing(
    small: fh.Controller, compiler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = fh.compile_controller(small, tmp_path / "arm.so")
    monkeypatch.setattr(compiled, "instructions", lambda: None)
    if b"avx" in path.read_bytes():
        with refused_with(InvalidInput, "neither", "--processor any"):
            fh.load_compiled(path)
    assert fh.load_compiled(fh.compile_controller(small, tmp_path / "any.so", "any")).step(
        [0.1] * 4
    ).shape == (1,)


def test_a_git_that_fails_is_not_an_installation_without_a_history(
    program: Program, only_programs: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(safety, "distribution", _raise_not_found)
    assert "its history" in safety.commit.__wrapped__()
    program("git", "#!/bin/sh\necho 'fatal: detected dubious ownership' >&2\nexit 128\n")
    if not any((folder / ".git").exists() for folder in Path(safety.__file__).resolve().parents):
        pytest.skip("no clone: an installation has no history")
    text = safety.commit.__wrapped__()
    assert unnamed(text, "not known", fh.__version__, "dubious ownership") == []
    assert "its history" not in text


def _raise_not_found(name: str) -> None:
    raise safety.PackageNotFoundError(name)


# Packages -----------------------------------------------------------------------------------------------
def test_a_package_that_does_not_work_is_not_one_that_is_not_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from flexhinf.validation import optional_package, required_package

    monkeypatch.syspath_prepend(str(tmp_path))
    broken = {
        "lacks_a_library": "raise ImportError('libGL.so.1: cannot open shared object file')",
        "lacks_a_package": "import no_such_package",
    }
    for name, text in broken.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(text, encoding="utf-8")
        with refused_with(
            InvalidInput, name, "not work", "libGL" if "library" in name else "no_such_package"
        ):
            required_package(f"{name}.part", "It is not installed.", "pip install it")
        with refused_with(InvalidInput, name, "not work"):
            optional_package(name)
    assert optional_package("no_such_package.part") is None
    assert optional_package("json.no_such_part") is None
    with refused_with(InvalidInput, "It is not installed.", "no_such_package", "pip install it"):
        required_package("no_such_package.part", "It is not installed.", "pip install it")
    assert required_package("json.decoder", "", "") is sys.modules["json.decoder"]


def test_an_encoder_that_does_not_work_is_not_missing(
    tmp_path: Path, only_programs: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    from flexhinf.pages.film import check_film

    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "imageio_ffmpeg", raising=False)
    package = tmp_path / "imageio_ffmpeg.py"
    package.write_text("raise ImportError('its program is damaged')", encoding="utf-8")
    with refused_with(InvalidInput, "imageio_ffmpeg", "its program is damaged"):
        check_film(tmp_path / "arm.mp4")
    package.write_text("def get_ffmpeg_exe(): raise RuntimeError('none')", encoding="utf-8")
    with refused_with(InvalidInput, "encoder", "neither"):
        check_film(tmp_path / "arm.mp4")


def test_a_file_that_may_not_be_looked_at_is_not_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a folder of another user, which tests by the administrator do not meet."""

    def closed(self: Path) -> bool:
        raise PermissionError(13, "Permission denied", str(self))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "is_file", closed)
        for read in (fh.load_robot, fh.load_design):
            with refused_with(InvalidInput, "Permission denied", "chmod"):
                read(tmp_path / "arm")
    with refused_with(InvalidInput, "no robot"):
        fh.load_robot(tmp_path / "arm")
