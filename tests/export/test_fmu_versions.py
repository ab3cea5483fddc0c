"""FMI 3.0 beside 2.0: the same numbers, truthful dependencies, sources that build, and what is refused."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.builders import arm_controller
from tests.export.fmus import PERIOD, Fmu
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.export import export_fmu, export_plant_fmu

fmpy = pytest.importorskip("fmpy")

# Four FMUs that run for some samples: compiled in half the time.
pytestmark = [pytest.mark.usefixtures("unoptimised"), pytest.mark.ci("exports both versions")]

ARM = fh.paper_arm()
PLANT = ARM.plant()
SAMPLES, GOAL = 300, 0.6
VERSIONS = ("2.0", "3.0")


@pytest.fixture(scope="module")
def controller() -> fh.Controller:
    """One whose C compiles fast."""
    return arm_controller(kind=fh.ExtendedKalmanFilter)


@pytest.fixture(scope="module")
def files(
    controller: fh.Controller, compiler: str, tmp_path_factory: pytest.TempPathFactory
) -> dict[tuple[str, str], Path]:
    folder = tmp_path_factory.mktemp("fmu")
    made = {}
    for fmi in VERSIONS:
        made[fmi, "controller"] = export_fmu(controller, folder / f"controller-{fmi}.fmu", "arm", fmi)
        made[fmi, "plant"] = export_plant_fmu(PLANT, folder / f"plant-{fmi}.fmu", "robot", PERIOD, fmi=fmi)
    return made


@pytest.fixture
def instance(files: dict[tuple[str, str], Path], tmp_path: Path) -> Any:
    made: list[Fmu] = []

    def begun(fmi: str, kind: str) -> Fmu:
        made.append(Fmu(files[fmi, kind], tmp_path / str(len(made)), begun=False))
        return made[-1]

    yield begun
    for one in made:
        one.end()


@pytest.mark.ci("600 samples of two loops")
@pytest.mark.oracle
def test_a_loop_of_fmus_moves_as_simulated_in_both_versions(
    controller: fh.Controller, instance: Callable[[str, str], Fmu]
) -> None:
    run = fh.Loop(PLANT, controller).run(fh.Step(GOAL), duration=PERIOD * (SAMPLES - 1))
    expected, found = run.signals["state"], {}
    for fmi in VERSIONS:
        c, p = instance(fmi, "controller"), instance(fmi, "plant")
        c.run()
        p.run()
        rows = []
        for k in range(SAMPLES):
            rows.append(p.get(*(f"state.{name}" for name in PLANT.states)))
            (acting,) = c.get("u.motor_voltage")
            c.set({"measured.link_position": rows[-1][0], "command.link_position": GOAL})
            c.step(k)
            p.set({"u.motor_voltage": acting})
            p.step(k)
        found[fmi] = np.array(rows)
    assert np.array_equal(found["2.0"], found["3.0"])
    np.testing.assert_allclose(found["3.0"], expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.ci("exports and checks four FMUs")
@pytest.mark.oracle
def test_fmpy_finds_nothing_wrong_with_fmi_3_and_simulates_it_alike(
    files: dict[tuple[str, str], Path],
) -> None:
    from fmpy.validation import validate_fmu

    results = []
    for fmi in VERSIONS:
        for kind in ("controller", "plant"):
            assert validate_fmu(str(files[fmi, kind])) == []
        results.append(
            fmpy.simulate_fmu(
                str(files[fmi, "plant"]), stop_time=0.1, output_interval=PERIOD,
                start_values={"start.link_position": 0.3, "parameter.mass": 1.2, "u.motor_voltage": 2.0},
                output=["state.link_position", "measured.link_position"],
            )
        )  # fmt: skip
    assert results[0]["state.link_position"][0] == 0.3
    assert np.ptp(results[0]["state.link_position"]) > 1e-3
    assert all(np.array_equal(results[0][name], results[1][name]) for name in results[0].dtype.names)


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("kind", ["controller", "plant"])
def test_outputs_depend_on_what_is_stated_and_on_nothing_else(
    kind: str, fmi: str, instance: Callable[[str, str], Fmu]
) -> None:
    """At the start each stated dependency moves its output, and no other does; later nothing but a step does."""
    one = instance(fmi, kind)
    outputs, inputs = one.of("output"), one.of("input")
    stated = {u.variable.name: {d.name for d in u.dependencies} for u in one.about.initialUnknowns}
    assert [u.variable.name for u in one.about.outputs if u.dependencies != []] == []
    before = dict(zip(outputs, one.get(*outputs), strict=True))
    for name in [*inputs, *one.of("parameter")]:
        other = {"lower": 30.0, "upper": -30.0}.get(name.partition(".")[0], 0.7)
        (was,) = one.get(name)
        one.set({name: other})
        now = dict(zip(outputs, one.get(*outputs), strict=True))
        moved = {output for output in outputs if now[output] != before[output]}
        assert moved <= {output for output, names in stated.items() if name in names}
        if name.startswith(("start.link_position", "lower")):
            assert moved
        one.set({name: was})
    one.run()
    one.step(0)
    after = one.get(*outputs)
    one.set(dict.fromkeys(inputs, 0.5))
    assert one.get(*outputs) == after
    one.step(1)
    assert one.get(*outputs) != after


def test_fmi_3_has_time_states_that_come_back_and_refuses_what_it_cannot(
    instance: Callable[[str, str], Fmu],
) -> None:
    c = instance("3.0", "controller")
    c.run()
    c.set({"measured.link_position": 0.3})
    kept = c.model.getFMUState()
    for k in range(5):
        c.step(k)
    assert c.get("time") == pytest.approx([5e-3])
    after = c.get("u.motor_voltage")
    c.model.setFMUState(kept)
    c.model.freeFMUState(kept)
    c.step(0, 5e-3)  # five samples with the inputs held
    assert c.get("u.motor_voltage") == after
    (code,) = c.model.getInt32([c.at["code"]])
    assert code == 0
    c.model.setBoolean([c.at["is_measured"]], [False])
    c.step(5)
    assert c.model.getInt32([c.at["code"]]) == [5]
    failures: list[Callable[[], object]] = [
        lambda: c.step(6, 0.4e-3),
        lambda: c.step(6, 1.5e-3),
        lambda: c.step(6, float("nan")),
        lambda: c.get("code"),
        lambda: c.set({"u.motor_voltage": 1.0}),
        lambda: c.model.setInt32([c.at["status"]], [1]),
        lambda: c.model.getFloat32([c.at["code"]]),
    ]
    for failure in failures:
        with pytest.raises(fmpy.fmi1.FMICallException):
            failure()


@pytest.mark.parametrize("kind", ["controller", "plant"])
@pytest.mark.parametrize("fmi", VERSIONS)
def test_the_sources_compile_without_a_warning(
    fmi: str, kind: str, files: dict[tuple[str, str], Path], compiler: str, tmp_path: Path
) -> None:
    with zipfile.ZipFile(files[fmi, kind]) as archive:
        archive.extractall(tmp_path)
    strict = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only")
    shells = [str(path) for path in (tmp_path / "sources").glob("*_fmu.c")]
    assert shells
    subprocess.run([compiler, *strict, *shells], check=True)


@pytest.mark.ci("CMake builds two FMUs")
@pytest.mark.parametrize("fmi", VERSIONS)
def test_another_program_builds_the_sources(
    fmi: str, files: dict[tuple[str, str], Path], tmp_path: Path
) -> None:
    """fmpy makes a library of an archive without one, by what the archive says of its sources."""
    if shutil.which("cmake") is None:
        pytest.skip("missing: cmake")
    from fmpy.build import build_platform_binary

    whole, folder = files[fmi, "controller"], tmp_path / "sources only"
    with zipfile.ZipFile(whole) as archive:
        archive.extractall(folder, [name for name in archive.namelist() if not name.startswith("binaries")])
    (tmp_path / "build").mkdir()
    build_platform_binary(unzipdir=folder, build_dir=tmp_path / "build")
    given = {"measured.link_position": 0.05, "command.link_position": GOAL}
    runs = [
        fmpy.simulate_fmu(str(place), stop_time=0.05, output_interval=PERIOD, start_values=given)
        for place in (whole, folder)
    ]
    np.testing.assert_allclose(runs[1]["u.motor_voltage"], runs[0]["u.motor_voltage"], rtol=0, atol=1e-9)
    assert np.ptp(runs[0]["u.motor_voltage"]) > 0.1


def test_another_version_is_refused(controller: fh.Controller, tmp_path: Path) -> None:
    with refused_with(InvalidInput, "FMI", "'1.0'", "2.0"):
        export_fmu(controller, tmp_path / "arm.fmu", fmi="1.0")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.nightly("another master, ecospy, which no lock has")
@pytest.mark.oracle
@pytest.mark.parametrize("fmi", VERSIONS)
def test_ecos_connects_both_and_moves_them_as_simulated(fmi: str, compiler: str, tmp_path: Path) -> None:
    """Another master, which makes the steps of both at once: so a loop has one sample of latency, and knows it."""
    pytest.importorskip("ecospy", reason="missing: ecospy")
    try:
        import ecospy  # type: ignore[import-not-found]
    except OSError as error:
        if "libtbb" not in str(error):
            raise
        pytest.skip(f"missing: oneTBB, which ecospy needs ({error})")
    late = arm_controller(kind=fh.ExtendedKalmanFilter, latency=1)
    run = fh.Loop(PLANT, late).run(fh.Step(GOAL), duration=PERIOD * (SAMPLES - 1))
    found = []
    with ecospy.EcosSimulationStructure() as structure:
        structure.add_model("c", str(export_fmu(late, tmp_path / "c.fmu", "arm", fmi)))
        structure.add_model("p", str(export_plant_fmu(PLANT, tmp_path / "p.fmu", "robot", PERIOD, fmi=fmi)))
        structure.make_real_connection("p::measured.link_position", "c::measured.link_position")
        structure.make_real_connection("c::u.motor_voltage", "p::u.motor_voltage")
        with ecospy.EcosSimulation(structure=structure, step_size=PERIOD) as simulation:
            simulation.init()
            simulation.set_real("c::command.link_position", GOAL)
            for _ in range(SAMPLES):
                found.append([simulation.get_real(f"p::state.{name}") for name in PLANT.states])
                simulation.step(1)
    expected = run.signals["state"]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
