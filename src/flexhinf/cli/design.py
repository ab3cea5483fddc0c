"""``flexhinf design``, to a judged controller; ``flexhinf compare``, to several; ``flexhinf paper``, every claim.

``flexhinf certify``: a proved region of a design's law as certificate.json, and its independent check.
``flexhinf run``: driving a robot in real time.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, nullcontext
from dataclasses import asdict, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from shlex import join, quote
from typing import TYPE_CHECKING, Any

import typer

import flexhinf as fh
from flexhinf import export, pages, report
from flexhinf.cli.arguments import (
    fields_of,
    of_workspace_proof,
    refuse_idle,
    refuse_stated,
    reproduce_command,
    request_of,
    stated_options,
    with_options,
)
from flexhinf.cli.designs import (
    design_of,
    file_of,
    keep,
    note_unlimited,
    other_robot,
)
from flexhinf.cli.messages import NOT_MET, ProofProgress, note, options, show, specification, step_progress
from flexhinf.copies import cpu_seconds
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.options import option_name, with_value

if TYPE_CHECKING:
    from flexhinf.designs import Advice, WorkspaceEvidence
    from flexhinf.designs.request import DesignRequest

#: Steps by which the bar of advice moves; a trial has about five, and some end early.
TRIAL_STEPS = 12

#: In the folder of a report: the robot's file with joints that are rigid, where that was tried and meets all.
RIGID_FILE = "rigid.toml"

#: Of verdicts.
COLOURS = {"holds": "green", "fails": "red", "ties": "yellow", "not judged": "bright_black"}


@with_options(lambda: (options.DesignOptions, options.ALL))
def design(context: typer.Context, o: options.DesignOptions) -> int:
    """Design a controller for a robot, test it, and write a report.

    By default one controller serves the workspace: all poses within the joint
    limits, or within --workspace. It is tested at random poses and in moves
    between random goals. With --pose it is made for one pose (home is the
    robot's own) and tested by the step to it, or by the move of --move.

    --law names the law: modal by default, nl-hinf with --pose. --estimator
    auto chooses what suits law and sensors. No other option changes the kind
    of controller: one that law, estimator and task do not read is refused.
    design.toml states law and estimator.

    The folder also holds design.toml, with the specification and its result.
    `flexhinf design design.toml` makes the same design again; options win
    over the file.

    Exit code: 0 if the loop meets the specification; 1 if it does not
    (the report is written, and says so); 2 for a mistake, or for a
    specification that cannot be met (nothing is written); 130 if interrupted.
    """
    from flexhinf.designs import WorkspaceEvidence, design_with, stages
    from flexhinf.designs.design_file import robot_digests
    from flexhinf.robot.saved_file import robot_text

    request = request_of(context, o, o.robot, o.elastic)
    refuse_idle(context, request)
    folder = report.check(o.out)
    other = other_robot(folder, request.robot.name)
    note_unlimited(request.robot, request.specification)
    origins = robot_digests(request.source, request.elastic, folder)
    ending = [("report", 2.5)]
    begun, command, others = cpu_seconds(), reproduce_command(context), ExitStack()
    early: list[pages.EarlyParts] = []

    def meanwhile() -> Callable[[WorkspaceEvidence], None]:
        early.append(others.enter_context(pages.EarlyParts()))  # pages are loaded only now
        return early[0].begin

    def written(result: fh.Design, advice: Advice | None = None) -> None:
        files = pages.design_files(result, command, request.warnings, ("design.toml",), advice, *early)
        files["design.toml"] = pages.design_text(result, request, folder)
        if advice is not None and advice.found is not None and advice.found.change.rigid:
            rigid = request.robot.with_rigid(*advice.found.change.rigid)
            files[RIGID_FILE] = robot_text(rigid, folder)
        report.write(folder, files, origins)

    with others, step_progress([*stages(request.robot, request.specification), *ending]) as progress:
        result = design_with(request.robot, request.specification, progress, meanwhile)
        progress("report")
        keep(folder, other)
        written(result)
    advice = None
    evidence = result.evidence
    if o.advice and isinstance(evidence, WorkspaceEvidence) and not result.met:
        try:
            own = request.file is None and request.elastic is None and result.robot.file is not None
            advice = _advice(context, evidence, cpu_seconds() - begun, o.out, joints=own)
        except KeyboardInterrupt:  # the report is written, and the user has not seen it yet
            _show_design(result, folder, o, None)
            raise
        written(result, advice)
    _show_design(result, folder, o, advice)
    return 0 if result.met else NOT_MET


def _advice(
    context: typer.Context, design: WorkspaceEvidence, seconds: float, out: Path, joints: bool
) -> Advice:
    """What is tried after a design that misses a requirement, in so much CPU time, with the command that meets all.

    `joints`: whether a file with rigid joints can be written into `out`, which that command does not replace.
    """
    from flexhinf.designs import advise

    with step_progress([("try", 1.0)] * TRIAL_STEPS) as progress:
        advice = advise(design, seconds, progress, joints)
    if advice.found is None:
        return advice
    fields = advice.found.change.fields
    known = specification.FIELDS
    options = [word for name in fields for word in with_value(known[name].option, fields[name]).split()]
    if advice.found.change.rigid:
        own = reproduce_command(context, {*fields, "advice", "robot", "out"})
        place = own.index("design") + 1
        options += ["--out", f"{out}-rigid"]
        command = [*own[:place], str(out / RIGID_FILE), *own[place:]]
    else:
        command = reproduce_command(context, {*fields, "advice"})
    return replace(advice, command=(*command, *options))


def _show_design(result: fh.Design, folder: Path, o: options.DesignOptions, advice: Advice | None) -> None:
    """The verdict, and what to do next."""
    if o.verbose:
        tables, notes, text = pages.details(result)
        show(tables, notes)
        typer.echo(f"{text}\n")
    tables, text = pages.ending(result, advice)
    show(tables)
    typer.echo(f"{text}\nreport: {folder / 'index.html'}")
    if advice is not None and advice.command:
        typer.echo(f"next: {join(advice.command)}  # meets every requirement")
        return
    if not result.loop.has_controller:
        typer.echo(f"next: flexhinf campaign run {quote(str(o.out))}  # tries it on many robots")
        return
    why = "" if result.met else "  # shows this design as it is"
    typer.echo(f"next: flexhinf export web {quote(str(o.out))}{why}")


@with_options(lambda: (options.CompareOptions, options.ALL))
def compare(context: typer.Context, o: options.CompareOptions) -> None:
    """Compare a design with other laws on the same robot.

    Each law is designed for the same task, the workspace or --pose, as
    `flexhinf design --law NAME` designs it: the fastest that keeps all limits, or
    with the numbers of --gains. All are judged by the same requirements, at the
    same poses, in the same moves and on the same robots.

    The criterion is stated first. The result is a table and a page, whose
    headline names the best rival.

    Exit code: 0 when the report is written, whoever wins; 2 for a mistake
    (nothing is written); 130 if interrupted.
    """
    from flexhinf.designs import read_gains, stages

    request = request_of(context, o, o.robot, o.elastic)
    refuse_idle(context, request)
    chosen = tuple(name.strip() for name in o.laws.split(",") if name.strip()) or None
    gains = None if o.gains is None else read_gains(o.gains)
    folder = report.check(o.out)
    other = other_robot(folder, request.robot.name)
    steps = stages(request.robot, request.specification, chosen or ())
    with step_progress([*steps, ("report", 3.0)], lines=True) as progress:
        result = fh.compare(request.robot, request.specification, chosen, progress, o.same_sensors, gains)
        progress("report")
        files = pages.comparison_files(result, reproduce_command(context), request.warnings)
    keep(folder, other)
    report.write(folder, files)
    if o.verbose:
        tables, notes, text = pages.comparison_details(result)
        show(tables, notes)
        typer.echo(f"{text}\n")
    tables, text = pages.comparison_ending(result)
    show(tables)
    typer.echo(f"{text}\nreport: {folder / 'index.html'}")


@with_options(lambda: (options.PaperOptions, ()))
def paper(context: typer.Context, o: options.PaperOptions) -> None:
    """Reproduce every figure and judge every claim of Elsa & Akbari (2014)."""
    from rich.markup import escape
    from rich.table import Table

    from flexhinf.paper.apart import judged_apart
    from flexhinf.paper.settings import PaperSettings

    settings = {name: value for name, value in asdict(o).items() if name not in ("out", "threads")}
    report.check(o.out)
    if o.degree % 2:
        note(
            f"the paper's arm is odd, so V has no terms of degree {o.degree}: it is degree {o.degree - 1} again."
        )
    # every setting, as defaults change
    settings_text = [word for name, value in settings.items() for word in (option_name(name), str(value))]
    out = [] if o.out == options.PaperOptions().out else ["--out", o.out.name]
    stated = PaperSettings(**settings)
    with judged_apart(stated) as apart:
        from flexhinf.paper import STAGES, reproduce  # while the other process loads it too
        from flexhinf.paper.claims import NOT_JUDGED

        drawings, command = pages.PaperDrawings(), ["flexhinf", "paper", *settings_text, *out]
        with step_progress(STAGES) as progress:
            result = reproduce(stated, command, progress, apart, drawings.draw)
    folder = report.write(o.out, pages.paper_files(result, drawings))
    title = (
        f"γ* of the paper's problem at the hanging rest (0°) = {result.metrics['gamma_star']:.4f}, "
        f"γ of its law here = {result.metrics['gamma']:.4f}"
    )
    for heading, claims in ((title, result.claims), ("Our own question", result.questions)):
        table = Table(title=heading, title_justify="left", show_lines=True)
        table.add_column("claim, and by what it is judged")
        table.add_column("verdict", no_wrap=True)
        for claim in report.by_verdict(claims):
            text = f"{escape(claim.text)}\n[dim]{escape(claim.criterion)}[/]"
            alone = "".join(f"\n{escape(part)}: {verdict}" for part, verdict in claim.parts.items())
            table.add_row(text, f"[{COLOURS[claim.verdict]}]{claim.verdict}[/]{alone}")
        show([table])
        if claims is result.claims:
            show([f"{report.summary(claims)} No printed curve was compared with a computed one."])
            said = "".join(f"\n- {escape(what)}" for what, _ in NOT_JUDGED)
            show([f"Not judged (the page says why):{said}"])
    typer.echo(f"report: {folder / 'index.html'}")


#: In the folder that is written of one pose; of a workspace it is `pages.PROOF_FILE`.
CERTIFICATE = "certificate.json"


@with_options(lambda: (options.CertifyOptions, options.CERTIFY_FIELDS))
def certify(context: typer.Context, o: options.CertifyOptions) -> int:
    """Prove how far the law of a design can be trusted.

    Writes a folder with a page and the proof. Of a controller for a workspace it
    proves which masses and payloads small motions about rest tolerate, over all
    vibrations of the workspace: proof.json. Without --pose that is what a robot
    of any number of joints has.

    Of one pose (--pose, law nl-hinf) of a robot of one joint it finds the largest
    level of V that can be proved about the goal: certificate.json. Inside, the
    gain from disturbances is bounded, and so are the steps from rest. The gain
    and the weights are those of --set checked_gamma_ratio and --set checked_penalty. The
    true state is fed back; with --observer the proof covers an observer too.
    With --tolerances it proves the step of the design for every robot within its
    tolerances. Weights that leave a state out, such as the paper's own, have no
    margin that could be proved: --preset damped finds others. Of one pose of a robot of more joints a region can only
    be sampled: `flexhinf design ROBOT --pose home --degrees 2 --damping 0.3 --set rays=50`.

    With --check, an independent program checks a certificate and reads nothing
    but the file. With --every-cell it trusts no rounding in doubles. --verbose
    prints the theorem with all its hypotheses.

    Exit code: 0 if something is proved, of a workspace for all that its file
    states of masses; 1 if it is not, or if a check refuses a certificate; 2 for a
    mistake, or where nothing can be proved of a pose; 130 if interrupted.
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
    from flexhinf.designs import known_design
    from flexhinf.designs.certification import (
        SAMPLED_ADVICE,
        NothingProved,
        SeveralJoints,
        certify_design,
        evidence,
        proved,
    )
    from flexhinf.designs.fields import law_of
    from flexhinf.designs.problem.presets import preset_of
    from flexhinf.designs.result import verdict_on

    request = request_of(context, o, o.robot, o.elastic)
    several = len(request.robot.joint_names) > 1
    if law_of(request.specification).any_pose:
        return _certify_workspace(context, o, request)
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
    if not several:
        refuse_idle(context, request, tolerances=o.tolerances, observer=o.observer is not None)
    folder = report.check(o.out)
    with ProofProgress() as bar:
        try:
            laws = certify_design(
                request.robot,
                request.specification,
                bar.step,
                bar.share,
                decay=o.decay,
                observer=o.observer,
                tolerances=o.tolerances,
            )
        except SeveralJoints as error:
            own = ("out", "check", "every_cell", "degree", "decay", "observer", "tolerances")
            command = reproduce_command(context, (*own, "degrees", "damping"))
            command[command.index("certify")] = "design"
            again = join([*command, "--degrees", "2", "--damping", "0.3", "--set", "rays=50"])
            raise InvalidInput(error.what, error.found, SAMPLED_ADVICE.format(again)) from None
        try:
            law = proved(laws, o.degree, o.tolerances or laws[0].box is not None)
        except NothingProved as error:
            raise InvalidInput(error.what, error.found, _whole_command(context, error.advice)) from None
        bar.step("pictures, and the worst disturbance")
        result = evidence(request.robot, request.specification, law)
        verdict = verdict_on(known_design(request))
        page = pages.certificate_page(
            laws, law, result, request.specification, reproduce_command(context), verdict
        )
        html = page.html()
    claim, file = result.certificate, folder / CERTIFICATE
    report.write(folder, {"index.html": html, CERTIFICATE: claim.text()})
    if o.verbose:
        show(
            pages.certification_tables(laws, request.specification.in_degrees),
            pages.certification_notes(laws),
        )
        typer.echo(f"{theorem_text(claim, claim.stated)}\n")
    tables, text = pages.certification_ending(laws, claim, verdict, request.specification.in_degrees)
    show(tables)
    typer.echo(
        f"{text}\nreport:      {folder / 'index.html'}\ncertificate: {file}\n"
        f"check:       {join(['flexhinf', 'certify', '--check', str(file)])}"
    )
    return 0


def _certify_workspace(context: typer.Context, o: options.CertifyOptions, request: DesignRequest) -> int:
    """Write what is proved of a controller for a workspace."""
    from flexhinf.designs import requested_loop
    from flexhinf.designs.workspace.evidence import LoopOverWorkspace
    from flexhinf.designs.workspace.proof import check_unknown_delay, prove_workspace

    refuse_stated(context, of_workspace_proof(request))
    check_unknown_delay(request.specification)
    folder = report.check(o.out)
    with ProofProgress() as bar:
        loop, verdict = requested_loop(request, bar.step)
        assert isinstance(loop, LoopOverWorkspace)
        proof = prove_workspace(loop.setup, bar.step, _loaded(request))
        page = pages.workspace_proof_page(proof, reproduce_command(context), verdict)
    files = {
        "index.html": page.html(),
        pages.PROOF_FILE: report.to_json(pages.workspace_proof_numbers(proof)),
    }
    report.write(folder, files)
    tables, text = pages.workspace_proof_ending(proof, verdict)
    show(tables)
    check = join(["flexhinf", "certify", "--check", str(folder / pages.PROOF_FILE)])
    typer.echo(
        f"{text}\nreport: {folder / 'index.html'}" + f"\ncheck:  {check}" * (proof.numbers is not None)
    )
    return 0 if proof.covers_file else NOT_MET


def _loaded(request: DesignRequest) -> fh.Robot | None:
    """The robot of a design with its payload, or with an unknown one at its last link; None where it takes none."""
    from flexhinf.designs.deployed_run import with_payload
    from flexhinf.robot.parameters import payload_masses

    if payload_masses(request.robot.parameters):
        return request.robot
    try:
        return with_payload(request, "0..1kg")
    except InvalidInput:
        return None


def _whole_command(context: typer.Context, advice: str) -> str:
    """An advice that begins with options, as this command with them; only the rest of it where they are stated."""
    stated, comma, others = advice.partition(", ")
    arguments = stated.split()
    settings = {word.partition("=")[0] for before, word in pairwise(arguments) if before == "--set"}
    names = settings | {word[2:].replace("-", "_") for word in arguments if word.startswith("--")}
    out = {"preset": ("penalty", "effort"), "degrees": ("degree",)}  # what contradicts an option
    gone = {*names, *(other for name in names for other in out.get(name, ()))}
    command, now = [*reproduce_command(context, gone), *arguments], reproduce_command(context)
    if sorted(command) == sorted(now):
        return others.removeprefix("or ")
    return f"{join(command)}{comma}{others}"


def _check(context: typer.Context, path: Path, o: options.CertifyOptions) -> int:
    """Check a certificate; nothing but its file is read, so options that state what is to be proved are a mistake."""
    from flexhinf.certify.certificate import theorem_text
    from flexhinf.designs.workspace.proof import pair_verdict, stored_proof

    for name in stated_options(context):
        refuse_if(
            name not in ("check", "every_cell", "threads", "robot", "verbose"),
            "A certificate is checked as it is.",
            f"expected --check FILE with --every-cell or --threads alone, got {fields_of(context)[name].switch}",
            f"flexhinf certify --check {path}",
        )
    refuse_if(
        o.robot,
        "A certificate is checked alone.",
        f"expected --check FILE without a robot or a design, got {o.robot!r}",
        f"flexhinf certify --check {path}",
    )
    if path.is_dir() and not (path / CERTIFICATE).exists() and (path / pages.PROOF_FILE).exists():
        path /= pages.PROOF_FILE
    if (numbers := stored_proof(path)) is not None:
        with ProofProgress() as bar:
            bar.step("check")
            verdict = pair_verdict(numbers)
        typer.echo(pages.pair_text(verdict))
        return 0 if verdict.is_proved else NOT_MET
    certificate = fh.load_certificate(path / CERTIFICATE if path.is_dir() else path)
    with ProofProgress() as bar:
        bar.step("check")
        result = certificate.check(sample=None if o.every_cell else 10, tick=bar.cells)
    if o.verbose:
        typer.echo(f"{theorem_text(certificate, result)}\n")
    typer.echo(pages.check_text(certificate, result))
    return 0 if result.proved else NOT_MET


def _run_settings(o: options.RunDesignOptions) -> dict[str, Any]:
    """Options of a run that its page names among the settings."""
    named = {
        "design": o.source,
        "library": o.library and str(o.library),
        "changed numbers": o.perturb or "none",
    }
    return named | {
        name: getattr(o, name) for name in ("load", "load_at", "noise", "realtime", "priority", "core")
    }


@with_options(lambda: (options.RunDesignOptions, options.RUN_FIELDS))
def run_design(context: typer.Context, o: options.RunDesignOptions) -> int:
    """Drive the robot in MuJoCo with the controller of a design, in real time.

    By default it makes the step of the design, or its move: what no option states
    is as in the design file. Options change the run and the robot that is driven,
    never the controller. Ctrl-C ends the run: what was recorded until then is
    written whole. With --ros it follows trajectories instead, which come as
    messages, and records nothing.

    Exit code: 0 if every deadline and every requirement was met; 1 if not;
    2 for a mistake; 130 if interrupted.
    """
    from flexhinf.cli.arguments import without_effect_on_run
    from flexhinf.designs.deployed_run import perturbed, prepare_run
    from flexhinf.designs.fields import law_of
    from flexhinf.designs.plans import has_integrals
    from flexhinf.designs.result import verdict_on
    from flexhinf.robot.mujoco import MuJoCoView, check_display, check_expressed
    from flexhinf.robot.parts import file_warnings

    path = file_of(
        o.source,
        "A run needs a design file, which states robot, start and goal.",
        "flexhinf run DIR --mujoco",
    )
    refuse_if(
        not (o.mujoco or o.ros),
        "No robot is named for the controller to drive.",
        "expected --mujoco or --ros, got none",
        "--mujoco, which simulates it",
    )
    if o.ros:
        from flexhinf.cli.ros import run_node

        return run_node(context, o, path)
    refuse_stated(context, {} if o.load is not None else {"load_at": "--load, which begins then"})
    logs, films = [export.check_log(path) for path in o.log], [pages.check_film(path) for path in o.record]
    folder = None if o.out is None else report.check(o.out)
    if o.view:
        check_display()
    compiled = None if o.library is None else export.load_compiled(o.library)
    request = request_of(context, o, str(path))
    check_expressed(request.specification.extras)
    robot = perturbed(request.robot, o.perturb)
    acting = partial(without_effect_on_run, request.specification, robot, o.noise)
    refuse_stated(context, acting(commanded=True))  # before the controller is designed, where it has to be
    with file_warnings():  # `request_of` has told them
        designed = design_of(path, tell=False)
    controller = designed.controller()
    refuse_stated(
        context,
        acting(commanded=has_integrals(controller.law), workspace=law_of(designed.specification).any_pose),
    )
    prepared = prepare_run(
        controller,
        (designed.robot, designed.specification),
        robot,
        request.specification,
        o.noise,
        o.load,
        o.load_at,
        verdict_on(designed),
        designed.loop.length,
    )
    with MuJoCoView(robot, prepared.box) if o.view else nullcontext() as viewer:
        run = fh.run_realtime(
            prepared.loop,
            **prepared.arguments,
            library=compiled,
            real_time=o.realtime,
            priority=o.priority,
            core=o.core,
            watch=None if viewer is None else viewer.show,
        )
    try:
        for path in logs:
            export.write_log(run, path)
    finally:  # a full disk takes the log, and not what the run has shown
        if o.verbose:
            show(pages.run_tables(prepared, run))
        tables, text = pages.run_ending(prepared, run)
        show(tables)
        typer.echo(text)
    for path in logs:
        typer.echo(f"log: {path}")
    if films:
        with step_progress(len(films)) as progress:
            for path in films:
                progress(f"draw {path.name}")
                pages.write_film(prepared, run, path)
    for path in films:
        typer.echo(f"film: {path}")
    if folder is not None:
        report.write(folder, pages.run_files(prepared, run, reproduce_command(context), _run_settings(o)))
        typer.echo(f"report: {folder / 'index.html'}")
    if run.stopped is None:
        return 0 if pages.run_met(prepared, run) else NOT_MET
    return 128 + run.stopped if run.stopped else 0  # 0: the view was closed
