"""Every public name has an example in its docstring that runs; no result fills more than a screen."""

from __future__ import annotations

import doctest
import inspect
import re
import shutil
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.designs.campaign_options import CampaignOptions
from flexhinf.designs.result import CampaignKeywords, ComparisonKeywords
from flexhinf.export.protection import protected
from flexhinf.loop import ControllerOptions

# A kernel of each class that runs once or twice: 4 s instead of 5 s
pytestmark = pytest.mark.usefixtures("unoptimised")

#: Names whose examples take long, or need another compiler; those that are one example together.
LONG = [("Comparison", "compare"), ("export_web",)]

#: Of tests that look at an object of each public class.
SHOWN = pytest.mark.ci("makes all of them: designs, filters, identifies, proves, compiles")

#: Rows and columns of a terminal.
ROWS, COLUMNS = 24, 80


def examples(name: str) -> list[doctest.Example]:
    """Those of the docstring itself: not those of a method."""
    return doctest.DocTestParser().get_examples(own(name))


def own(name: str) -> str:
    return getattr(fh, name).__doc__ or ""


@pytest.mark.parametrize("name", sorted(set(fh.__all__) - {"__version__"}))
def test_every_public_name_has_an_example(name: str) -> None:
    found = examples(name)
    assert found
    assert any(name in example.source for example in found) or inspect.isclass(getattr(fh, name))


@pytest.mark.ci("designs, compares laws and compiles for the web")
@pytest.mark.parametrize("names", LONG, ids=" ".join)
def test_examples_that_take_long_run_too(names: tuple[str, ...]) -> None:
    """They are skipped where the others are run; a line that two of them have runs once."""
    if "export_web" in names and not (shutil.which("clang") and shutil.which("wasm-ld")):
        pytest.skip("missing: clang or wasm-ld")
    parser, runner = doctest.DocTestParser(), doctest.DocTestRunner()
    assert all("# doctest: +SKIP" in own(name) for name in names)
    text = "\n\n".join(map(own, names)).replace("# doctest: +SKIP", "")
    test = parser.get_doctest(text, {}, names[0], None, 0)
    test.examples = list({example.source: example for example in test.examples}.values())
    assert runner.run(test).failed == 0


def test_only_those_are_skipped() -> None:
    skipped = {name for name in fh.__all__ if "+SKIP" in own(name)}
    assert skipped == {name for names in LONG for name in names}


# Types ------------------------------------------------------------------------------------------------
#: What has no type of its own, and why.
UNTYPED = {
    "Controller.to_control(return)": "python-control, which is installed for it alone, has no types",
    "Loop.to_control(return)": "as of a controller",
    "Model.to_control(return)": "as of a controller",
    "Model.__init__(parameters)": "numbers by name, which the plant keeps as their table",
    "Plant.__init__(parameters)": "as of a model",
    "Trajectory.__init__(settings)": "what a run was made with: numbers, texts and names",
    "Trajectory.until(settings)": "as of a trajectory",
}


def functions_of(thing: Any) -> list[Any]:
    """Functions, methods and properties of a public name that this package wrote, inherited ones too."""
    if not inspect.isclass(thing):
        return [thing] if inspect.isfunction(thing) else []
    members = (
        one for kind in thing.__mro__ if kind.__module__.startswith("flexhinf") for one in vars(kind).values()
    )
    members = (getattr(one, "fget", one) for one in members)
    members = (getattr(one, "__func__", getattr(one, "func", one)) for one in members)
    return [one for one in members if inspect.isfunction(one)]


def test_public_signatures_are_typed() -> None:
    untyped = {
        f"{one.__qualname__}({each})"
        for name in set(fh.__all__) - {"__version__"}
        for one in functions_of(getattr(fh, name))
        if one.__name__ == "__init__" or not one.__name__.startswith("_")
        for each, kind in one.__annotations__.items()
        if re.search(r"\bAny\b", str(kind))
    }
    assert untyped == {*UNTYPED}


@pytest.mark.parametrize(
    ("keywords", "function", "own"),
    [
        (ControllerOptions, fh.Controller.__init__, ("self", "solution", "estimator", "period")),
        (CampaignKeywords, CampaignOptions, ("samples",)),
        (ComparisonKeywords, fh.compare, ("robot", "specification", "laws")),
    ],
)
def test_keywords_that_are_passed_on_are_those_that_are_taken(keywords: Any, function: Any, own: Any) -> None:
    assert [*own, *keywords.__annotations__] == [*inspect.signature(function).parameters]


# Reprs ------------------------------------------------------------------------------------------------
def screen_lines(text: str) -> int:
    return sum(max(1, -(-len(line) // COLUMNS)) for line in text.splitlines())


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """An object of each public class, of the largest robots where that is quick."""
    arm, seven = fh.paper_arm(), fh.load_robot("seven-link")
    problem = arm.problem([70.0, 18.0, 60.0, 18.0, 320.0])
    solution = fh.solve_hji(problem, 1.5 * fh.smallest_gamma(problem), degree=4)
    ukf = fh.UnscentedKalmanFilter(arm.plant(), 1e-2, 1e-8, 1e-6, np.zeros(4), 1e-4)
    ekf = fh.ExtendedKalmanFilter(arm.plant(), 1e-2, 1e-8, 1e-6, np.zeros(4), 1e-4)
    watch = fh.Supervision((-2.0, 2.0))
    controller = fh.Controller(solution, ekf, 1e-2, supervision=watch)
    loop = fh.Loop(arm.plant(), controller)
    run = loop.run(fh.Sine(0.3, frequency=0.5), noise=1e-3, duration=4.0)
    data, time = fh.filter_log(ekf, run), np.linspace(0.0, 1.0, 11)
    polynomial = fh.PolynomialPlant({(1,): [1.0], (3,): [-1.0]}, [[1.0]], [[1.0]], {(1,): [1.0]}, 1.0)
    whole = seven.plant(("link_position", "motor_position"))
    noise = np.diag(np.repeat([0.0, 1e-4, 0.0, 1e-2], 7))
    modal = fh.ExtendedKalmanFilter(whole, 1e-3, noise, 1e-8, np.zeros(28), noise, form="covariance")
    library = fh.compile_controller(
        fh.Controller(solution, None, 1e-2), tmp_path_factory.mktemp("c") / "a.so"
    )
    large = seven.problem({"link_position": 1.0, "link_position_integral": 1.0})
    quick: dict[str, Any] = {
        "degrees": "2",
        "draws": 0,
        "rays": 0,
        "proof_seconds": 0,
    }
    wanted = fh.Specification(pose="10deg", start="0", estimator="none", **quick)
    return {
        "Robot": seven, "Plant": whole, "GeneralisedPlant": large,
        "PolynomialPlant": polynomial, "HJISolution": solution, "UnscentedKalmanFilter": ukf,
        "ExtendedKalmanFilter": modal, "ModalFilter": fh.ModalFilter(modal), "Controller": controller, "Loop": loop,
        "Trajectory": run, "Schedule": fh.Schedule([solution]), "Supervision": watch, "Status": controller.status,
        "Certificate": fh.solve_hji(polynomial, 1.5, 4).certify(gamma=2.0), "Penalty": problem.penalty,
        "Design": fh.design(arm, wanted), "Specification": wanted, "CompiledController": fh.load_compiled(library),
        "Identification": fh.identify(arm.with_values({"stiffness": 90.0}), run, "stiffness"),
        "Excitation": fh.excitation(arm, "stiffness", duration=4.0, period=1e-2, candidates=1),
        "Log": fh.Log(run.time, run.signals["input"], run.signals["output"]), "Consistency": fh.consistency(data),
        "OutputInjectionObserver": fh.OutputInjectionObserver(arm.plant(), 1e-2, 1e-6, 1e-6, mean=np.zeros(4)),
        "Gaussian": ukf.initial, "ModalLaw": fh.ModalLaw.tuned(large),
        "Moving": fh.Moving(fh.Quintic(0.0, 1.0, 1.0), arm.inverse_dynamics), "Sensor": fh.Sensor("motor_position"),
        "OutputError": fh.OutputError({"stiffness": 98.0}, {"stiffness": 0.5}, {}, {}, np.zeros(4), ()),
        "LogFinding": fh.LogFinding("gap", "doubt", "A gap of 0.8 s.", "Cut the log there.", "time", rows=(7, 8)),
        "Feedforward": fh.Feedforward(fh.load_robot("planar-two-link"), period=4e-3, smoothing=0.02),
        "Follower": fh.Follower(fh.load_robot("planar-two-link"), period=1e-3),
        "FollowGoal": fh.FollowGoal(["elbow"], [0.5], [[0.1]]),
        "JerkLimited": fh.JerkLimited(0.0, 1.0, 1.0, 4.0, 40.0), "Spline": fh.Spline(time, np.sin(time)),
        "Waypoints": fh.Waypoints(time, np.sin(time)), "Samples": fh.Samples(np.arange(1e4), np.arange(1e4)),
        "Braked": fh.Braked(fh.Sine(1.0, frequency=0.5), at=1.0), "Constant": fh.Constant(1.0), "Step": fh.Step(1.0),
        "Sine": fh.Sine(1.0, frequency=0.5), "Quintic": fh.Quintic(0.0, 1.0, 1.0), "Parameter": arm.parameters[0],
        "Protection": protected(controller, arm)[0].protection, "Stop": ~fh.Stop(0), "Start": ~fh.Start(0),
        "Diagnosis": fh.Diagnosis("innovations", 3, "a larger noise"), "modes": seven.modes(), "filter_log": data,
    }  # fmt: skip


@SHOWN
def test_a_repr_fills_a_screen_at_most(results: dict[str, Any]) -> None:
    shown = {name: screen_lines(repr(result)) for name, result in results.items() if name != "filter_log"}
    assert {name: lines for name, lines in shown.items() if lines > ROWS} == {}


@SHOWN
def test_every_public_class_is_shown(results: dict[str, Any]) -> None:
    bases = {"BlackBox", "Estimator", "Law"}
    long = {"Comparison"}  # tests/design
    classes = {
        name
        for name in fh.__all__
        if inspect.isclass(kind := getattr(fh, name)) and not issubclass(kind, Exception)
    }
    assert classes - bases - long <= set(results)


@SHOWN
def test_tables_of_a_notebook_are_as_short(results: dict[str, Any]) -> None:
    for result in results.values():
        if hasattr(result, "summary"):
            facts = result.summary()
            assert len(facts) <= ROWS
            assert all(len(text) <= 4 * COLUMNS for text in facts.values()), type(result)
