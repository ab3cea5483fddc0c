"""``flexhinf design``, to a judged controller; ``flexhinf compare``, to several; ``flexhinf paper``, every claim.

``flexhinf certify``: a proved region of a design's law as certificate.json, and its independent check.
``flexhinf export``, ``compile`` and ``run``: a controller as code for a robot, and driving one in real time.
"""

from __future__ import annotations

import os
import warnings
from contextlib import nullcontext
from dataclasses import asdict
from functools import partial
from pathlib import Path
from shlex import join

import typer

import flexhinf as fh
from flexhinf import export, pages, report
from flexhinf.cli.arguments import (
    NOT_MET,
    ProofProgress,
    note,
    refuse_idle,
    refuse_stated,
    reproduce_command,
    request_of,
    show,
    stated_options,
    step_progress,
    with_options,
)
from flexhinf.cli.options import (
    ALL,
    CERTIFY_FIELDS,
    COMPARE_FIELDS,
    RUN_FIELDS,
    CertifyOptions,
    CompareOptions,
    CompileOptions,
    DesignOptions,
    ExportCOptions,
    ExportFmuOptions,
    PaperOptions,
    RunOptions,
)
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.options import option_name
from flexhinf.validation import checked_path, value_text

#: Of verdicts.
COLOURS = {"holds": "green", "fails": "red", "ties": "yellow", "not judged": "bright_black"}


@with_options(DesignOptions, ALL)
def design(context: typer.Context, o: DesignOptions) -> int:
    """From a robot to a judged controller, and its report.

    By default one controller for the workspace: all poses within the joint
    limits, or --workspace. It is judged at random poses and in moves between
    random goals. With an option that only a design of one pose reads, as --pose,
    --preset or --degrees, it is for that pose (by default the robot's home):
    weights, γ*, a nonlinear law, region, runs. The report says which it is.

    The folder also holds design.toml: the specification and its result.
    `flexhinf design design.toml` makes the same design again; options win
    over it.

    Exit code: 0 if the loop meets the specification; 1 if it does not
    (the report is written, and says so); 2 for a mistake, or for what cannot
    be met (nothing is written); 130 if interrupted.
    """
    from flexhinf.design import stages

    request = request_of(context, o, o.robot, o.elastic)
    refuse_idle(context, request)
    folder = report.check(o.out)
    with step_progress(stages(request.robot, request.specification) + 1) as progress:
        result = fh.design(request.robot, request.specification, progress)
        progress("report")
        files = pages.design_files(result, reproduce_command(context), request.warnings, ("design.toml",))
        files["design.toml"] = pages.design_text(result, request, folder)
    report.write(folder, files)
    tables, notes, text = pages.terminal_blocks(result)
    show(tables, notes)
    typer.echo(f"{text}\nreport: {folder / 'index.html'}")
    return 0 if result.met else NOT_MET


@with_options(CompareOptions, COMPARE_FIELDS)
def compare(context: typer.Context, o: CompareOptions) -> None:
    """Which law is best for this robot: the nonlinear H∞ law, or one that you would use instead?

    Laws by name on the same plants, with the same commands, disturbances and
    seeds, each with its own sensors and tuned over all its parameters for one
    criterion that is stated first: one table, one figure, one page. The
    headline names the best rival.

    Exit code: 0 when the report is written, whoever wins; 2 for a mistake
    (nothing is written); 130 if interrupted.
    """
    from rich.console import Console

    from flexhinf.design import law_names, stages

    request = request_of(context, o, o.robot, o.elastic)
    refuse_idle(context, request)
    chosen = tuple(name.strip() for name in o.laws.split(",") if name.strip()) or None
    folder = report.check(o.out)
    count = stages(request.robot, request.specification, law_names(chosen))
    with step_progress(count + 1) as progress:
        result = fh.compare(request.robot, request.specification, chosen, o.tune, progress, o.same_sensors)
        progress("report")
        files = pages.comparison_files(result, reproduce_command(context), request.warnings)
    report.write(folder, files)
    typer.echo(f"Criterion: {result.criterion.text}")
    show(pages.comparison_tables(result, Console().width), pages.comparison_notes(result))
    typer.echo(f"{pages.comparison_verdict(result)}\nreport: {folder / 'index.html'}")


@with_options(PaperOptions)
def paper(context: typer.Context, o: PaperOptions) -> None:
    """Reproduce every figure and judge every claim of Elsa & Akbari (2014)."""
    from rich.markup import escape
    from rich.table import Table

    from flexhinf.paper import STAGES, PaperSettings, reproduce

    settings = {name: value for name, value in asdict(o).items() if name != "out"}
    report.check(o.out)
    if o.degree % 2:
        note(
            f"the paper's arm is odd, so V has no terms of degree {o.degree}: it is degree {o.degree - 1} again."
        )
    # every setting, as defaults change
    stated = [word for name, value in settings.items() for word in (option_name(name), str(value))]
    out = [] if o.out == PaperOptions().out else ["--out", o.out.name]
    with step_progress(STAGES) as progress:
        result = reproduce(PaperSettings(**settings), ["flexhinf", "paper", *stated, *out], progress)
    folder = report.write(o.out, result.files)
    title = (
        f"γ* of the paper's problem = {result.metrics['gamma_star']:.4f}, "
        f"γ of its law here = {result.metrics['gamma']:.4f}"
    )
    for heading, claims in ((title, result.claims), ("Our own question", result.questions)):
        table = Table(title=heading, title_justify="left", show_lines=True)
        table.add_column("claim, and by what it is judged")
        table.add_column("verdict", no_wrap=True)
        for claim in report.by_verdict(claims):
            text = f"{escape(claim.text)}\n[dim]{escape(claim.criterion)}[/]"
            table.add_row(text, f"[{COLOURS[claim.verdict]}]{claim.verdict}[/]")
        show([table])
        if claims is result.claims:
            show([f"{report.summary(claims)} No printed curve was compared with a computed one."])
    typer.echo(f"report: {folder / 'index.html'}")


#: In the folder that is written.
CERTIFICATE = "certificate.json"


@with_options(CertifyOptions, CERTIFY_FIELDS)
def certify(context: typer.Context, o: CertifyOptions) -> int:
    """Prove how far the law of a design can be trusted: a folder with a page and certificate.json.

    The largest level of V that can be proved about the goal, by arithmetic that
    cannot round the wrong way: the gain from disturbances, and the largest steps
    from rest inside. What is proved is stated by --checked-gamma-ratio and
    --checked-penalty. The true state is fed back, and with --observer also the
    estimates of an output-injection observer. For robots of one joint; of others
    `flexhinf design ROBOT --degrees 2 --damping 0.3 --rays 50` samples a region.

    With --tolerances, the smallest gain that is found to hold for the step of the
    design on every robot within its tolerances, for the robot's own penalty.

    With --check, another program proves a certificate again and reads nothing but
    the file; the theorem is printed with its hypotheses and what is not proved.
    With --every-cell it trusts no rounding in doubles at all.

    Exit code: 0 if something is proved; 1 if a check refuses a certificate;
    2 for a mistake, or where nothing can be proved; 130 if interrupted.
    """
    refuse_if(
        o.every_cell and o.check is None,
        "Every cell is proved twice in a check only.",
        "expected --every-cell with --check FILE, got it without",
        "flexhinf certify --check certificate.json --every-cell",
    )
    if o.check is not None:
        return _check(context, o.check, o)
    refuse_if(
        not o.robot,
        "Nothing is named to certify.",
        "expected a robot, a design file, or --check FILE, got none of them",
        "flexhinf certify design.toml",
    )
    from flexhinf.certify.certificate import theorem_text
    from flexhinf.design.certification import (
        SAMPLED_ADVICE,
        SeveralJoints,
        certify_design,
        evidence,
        proved,
    )
    from flexhinf.design.problem.presets import preset_of

    request = request_of(context, o, o.robot, o.elastic)
    boxed = "--tolerances" if o.tolerances else "--preset proved"
    other = "--decay" if o.decay else "--observer"
    refuse_if(
        (o.tolerances or preset_of(request.robot, request.specification) == "proved")
        and (o.decay or o.observer is not None),
        f"{boxed} and {other} contradict each other.",
        "expected a proof for all tolerances, of the law fed the true state and without a rate of decay, or one "
        "for the nominal robot; got both",
        f"leave out {other}, or {boxed}",
    )
    if len(request.robot.joint_names) == 1:
        refuse_idle(context, request, tolerances=o.tolerances, observer=o.observer is not None)
    folder = report.check(o.out)
    with ProofProgress() as bar:
        try:
            laws = certify_design(
                request.robot, request.specification, bar.step, bar.share, decay=o.decay, observer=o.observer,
                tolerances=o.tolerances, threads=o.threads,
            )  # fmt: skip
        except SeveralJoints as error:
            own = ("out", "check", "every_cell", "degree", "decay", "observer", "tolerances", "threads")
            command = reproduce_command(context, (*own, "degrees", "damping"))
            command[command.index("certify")] = "design"
            again = join([*command, "--degrees", "2", "--damping", "0.3", "--rays", "50"])
            raise InvalidInput(error.what, error.found, SAMPLED_ADVICE.format(again)) from None
        law = proved(laws, o.degree, o.tolerances or laws[0].box is not None)
        bar.step("pictures, and the worst disturbance")
        result = evidence(request.robot, request.specification, law)
        page = pages.certificate_page(laws, law, result, request.specification, reproduce_command(context))
        html = page.html()
    show(pages.certification_tables(laws), pages.certification_notes(laws))
    report.write(folder, {"index.html": html, CERTIFICATE: result.certificate.text()})
    file = folder / CERTIFICATE
    typer.echo(
        f"{theorem_text(result.certificate, result.certificate.stated)}\nreport:      {folder / 'index.html'}\n"
        f"certificate: {file}\ncheck:       {join(['flexhinf', 'certify', '--check', str(file)])}"
    )
    return 0


def _check(context: typer.Context, path: Path, o: CertifyOptions) -> int:
    """Check a certificate; nothing but its file is read, so options that state what is to be proved are a mistake."""
    from flexhinf.certify.certificate import theorem_text, verification_text

    for name in stated_options(context):
        refuse_if(
            name not in ("check", "every_cell", "threads", "robot"),
            "A certificate is checked as it is.",
            f"expected --check FILE with --every-cell or --threads alone, got {option_name(name)}",
            f"flexhinf certify --check {path}",
        )
    refuse_if(
        o.robot,
        "A certificate is checked alone.",
        f"expected --check FILE without a robot or a design, got {o.robot!r}",
        f"flexhinf certify --check {path}",
    )
    certificate = fh.load_certificate(path / CERTIFICATE if path.is_dir() else path)
    with ProofProgress() as bar:
        bar.step("check")
        result = certificate.check(threads=o.threads, sample=None if o.every_cell else 10, tick=bar.cells)
    typer.echo(f"{theorem_text(certificate, result)}\n\n{verification_text(result)}")
    return 0 if result.proved else NOT_MET


app = typer.Typer(help="Write the controller of a design as what runs on a robot.")


@app.command("c")
@with_options(ExportCOptions)
def export_c(context: typer.Context, o: ExportCOptions) -> None:
    """Dependency-free C99: two files, a test vector, and what firmware needs around them.

    `make test` in the folder compiles them and runs the recorded samples: the
    numbers are those of the simulation. README.md there has signals, units,
    memory and cost.
    """
    if o.name:
        export.checked_identifier(o.name)
    folder = export.checked_folder(o.out, o.force)
    controller, robot = controller_of(o.source)
    name = o.name or _identifier(robot)
    if uncounted := export.check_room(controller, o.real, period=o.period, flash=o.flash, ram=o.ram):
        note(uncounted)
    export.write_files(folder, export.controller_files(controller, name, o.real, robot))
    typer.echo(f"{name}.h, {name}.c and what goes with them: {folder}\ntest:  make -C {o.out} test")


@app.command("fmu")
@with_options(ExportFmuOptions)
def export_fmu(context: typer.Context, o: ExportFmuOptions) -> None:
    """A co-simulation FMU (FMI 2.0) for Simulink, OpenModelica and others.

    Of the controller: one communication step is one sample. With --plant, of
    the robot: motor inputs and disturbances in, measurements and states out,
    its parameters to be set. Needs a C compiler.
    """
    if o.plant:
        path = file_of(o.source, "A plant is that of a design file.", "flexhinf export fmu DIR --plant")
        robot, s = fh.load_design(path)
        equilibrium = robot.operating_point(s.pose if s.start is None else s.start, s.extras)
        name = o.name or export.identifier_of(robot.name)
        written = export.export_plant_fmu(
            robot.plant(s.measured, extras=s.extras), o.out, name, s.period, *equilibrium
        )
    else:
        controller, robot = controller_of(o.source)
        name = o.name or _identifier(robot)
        written = export.export_fmu(controller, o.out, name)
    typer.echo(f"FMU: {written}")


@with_options(CompileOptions)
def compile_design(context: typer.Context, o: CompileOptions) -> None:
    """The controller as a shared library that starts in milliseconds.

    fh.load_compiled(FILE) steps it from Python, without LLVM and CasADi; every
    output is the simulation's. For this platform; needs a C compiler.
    """
    controller, _ = controller_of(o.source)
    typer.echo(f"library: {export.compile_controller(controller, o.out, o.processor)}")


def _identifier(robot: fh.Robot | None) -> str:
    """The name of exported code, by the robot, as far as it is known."""
    return export.identifier_of("controller" if robot is None else robot.name)


def controller_of(source: str) -> tuple[fh.Controller, fh.Robot | None]:
    """The controller of a report, of a file, or of a design that is made now; and its robot, or None of a file."""
    from flexhinf.design.design_file import is_design_file

    path = file_of(source)
    if not is_design_file(path):
        robot_file = path.suffix.lower() in (".toml", ".urdf", ".xml") and path.exists()
        refuse_if(
            (source in fh.catalogue() or robot_file) and not Path(source).is_dir(),
            "A robot has no controller; a design of it has one.",
            f"expected design.toml, the folder of a report or the file of a controller, got {source!r}",
            f"flexhinf design {source} --out DIR, then DIR in the place of {source}",
        )
        return fh.load_controller(path), None
    robot, specification = fh.load_design(path)
    beside = path.parent / "controller"
    if report.unchanged(path.parent, ("design.toml", "controller")):
        return fh.load_controller(beside), robot
    if beside.exists():
        other = "the controller" if report.unchanged(path.parent, ("design.toml",)) else "design.toml"
        note(f"{other} was changed since the report: it is designed anew.")
    from flexhinf.design import stages

    with step_progress(stages(robot, specification)) as progress:
        result = fh.design(robot, specification, progress)
    note(pages.terminal_blocks(result)[2])
    return result.controller(), robot


def file_of(source: str, only_design: str = "", then: str = "") -> Path:
    """The file that a source names: of a report's folder its design file; refused where there is none.

    With `only_design`, the first sentence of the refusal, and the command `then`: also where it is no design file.
    """
    from flexhinf.design.design_file import is_design_file

    path = checked_path("The design", source)
    file = path / "design.toml" if os.path.isdir(path) else path
    what = "path leads to no file and no" if file == path else f"folder {value_text(source, 120)} holds no"
    refuse_if(
        not os.path.exists(file) and source not in fh.catalogue(),
        f"There is no file or design {value_text(source, 120)}.",
        f"expected design.toml, the folder of a report or the file of a controller; the {what} design.toml",
        "flexhinf design ROBOT --out DIR, then DIR in its place",
    )
    refuse_if(
        only_design and not is_design_file(file),
        only_design,
        f"expected design.toml or a report's folder, got {source!r}",
        f"flexhinf design ROBOT --out DIR, then {then}",
    )
    return file


@with_options(RunOptions, RUN_FIELDS)
def run_design(context: typer.Context, o: RunOptions) -> int:
    """The controller of a design drives the robot in MuJoCo, in real time.

    By default it makes the step of the design, or its move: what no option states
    is as in the design file. Options change the run and the robot that is driven,
    never the controller. Ctrl-C ends the run: what was recorded until then is
    written whole.

    Exit code: 0 if every deadline and every requirement was met; 1 if not;
    2 for a mistake; 130 if interrupted.
    """
    from flexhinf.cli.arguments import without_effect_on_run
    from flexhinf.design.deployed_run import perturbed, prepare_run
    from flexhinf.design.plans import has_integrals
    from flexhinf.robot.mujoco import MuJoCoView, check_display, check_expressed

    path = file_of(
        o.source,
        "A run needs a design file, which states robot, start and goal.",
        "flexhinf run DIR --mujoco",
    )
    refuse_if(
        not o.mujoco,
        "It is not said which robot is driven.",
        "expected --mujoco, the robot in MuJoCo, got none",
        "--mujoco",
    )
    refuse_stated(context, {} if o.load is not None else {"load_at": "--load, which begins then"})
    logs, films = [export.check_log(path) for path in o.log], [pages.check_film(path) for path in o.record]
    if o.view:
        check_display()
    compiled = None if o.library is None else export.load_compiled(o.library)
    request = request_of(context, o, str(path))
    check_expressed(request.specification.extras)
    robot = perturbed(request.robot, o.perturb)
    acting = partial(without_effect_on_run, request.specification, robot, o.noise)
    refuse_stated(context, acting(commanded=True))  # before the controller is designed, where it has to be
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # `request_of` has told them
        designed, (controller, _) = fh.load_design(path), controller_of(o.source)
    refuse_stated(context, acting(commanded=has_integrals(controller.law), moving=controller.mode.moving))
    prepared = prepare_run(controller, designed, robot, request.specification, o.noise, o.load, o.load_at)
    with MuJoCoView(robot, prepared.box) if o.view else nullcontext() as viewer:
        run = fh.run_realtime(
            prepared.loop, **prepared.arguments, library=compiled, real_time=o.realtime, priority=o.priority,
            core=o.core, watch=None if viewer is None else viewer.show,
        )  # fmt: skip
    try:
        for path in logs:
            export.write_log(run, path)
    finally:  # a full disk takes the log, and not what the run has shown
        show(pages.run_tables(prepared, run), pages.run_notes(run))
        typer.echo(pages.run_verdict(prepared, run))
    for path in logs:
        typer.echo(f"log: {path}")
    if films:
        with step_progress(len(films)) as progress:
            for path in films:
                progress(f"draw {path.name}")
                pages.write_film(prepared, run, path)
    for path in films:
        typer.echo(f"film: {path}")
    if run.stopped is None:
        return 0 if pages.run_met(prepared, run) else NOT_MET
    return 128 + run.stopped if run.stopped else 0  # 0: the view was closed
