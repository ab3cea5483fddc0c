"""``flexhinf design``, to a judged controller; ``flexhinf compare``, to several; ``flexhinf paper``, every claim.

``flexhinf certify``: a proved region of a design's law as certificate.json, and its independent check.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from shlex import join

import typer

from flexhinf import pages, report
from flexhinf.cli.arguments import (
    NOT_MET,
    ProofProgress,
    note,
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
    PEAKS,
    CertifyOptions,
    CompareOptions,
    DesignOptions,
    PaperOptions,
)
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.options import option_name

#: Of verdicts.
COLOURS = {"holds": "green", "fails": "red", "ties": "yellow", "not judged": "bright_black"}


@with_options(DesignOptions, ALL)
def design(context: typer.Context, o: DesignOptions) -> int:
    """From a robot to a judged controller: weights, γ*, law, region, runs, report.

    The folder also holds design.toml: the specification and its result.
    `flexhinf design design.toml` makes the same design again; options win
    over it.

    Exit code: 0 if the nonlinear loop meets the specification; 1 if it does not
    (the report is written, and says so); 2 for a mistake, or for what cannot
    be met (nothing is written); 130 if interrupted.
    """
    from flexhinf.design import design as make_design, stages

    request = request_of(context, o, o.robot, o.elastic)
    folder = report.check(o.out)
    with step_progress(stages(request.robot, request.specification) + 1) as progress:
        result = make_design(request.robot, request.specification, progress)
        progress("report")
        files = pages.design_files(result, reproduce_command(context), request.warnings, ("design.toml",))
        files["design.toml"] = pages.design_text(result, request, folder)
    report.write(folder, files)
    show(pages.design_tables(result), pages.notes(result))
    typer.echo(f"{pages.verdict(result)}\nreport: {folder / 'index.html'}")
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

    from flexhinf.design import compare as make_comparison, law_names, stages

    request = request_of(context, o, o.robot, o.elastic)
    chosen = tuple(name.strip() for name in o.laws.split(",") if name.strip()) or None
    folder = report.check(o.out)
    count = stages(request.robot, request.specification, law_names(chosen))
    with step_progress(count + 1) as progress:
        result = make_comparison(
            request.robot, request.specification, chosen, o.tune, progress, o.same_sensors
        )
        progress("report")
        files = pages.comparison_files(result, reproduce_command(context), request.warnings)
    report.write(folder, files)
    typer.echo(f"Criterion: {result.criterion.text}")
    show(pages.comparison_tables(result, Console().width), pages.comparison_notes(result))
    typer.echo(f"{pages.comparison_verdict(result)}\nreport: {folder / 'index.html'}")


@with_options(PaperOptions)
def paper(context: typer.Context, o: PaperOptions) -> None:
    """Reproduce every figure and judge every claim of Elsa & Akbari (2014)."""
    from rich.console import Console
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
    console = Console()
    for heading, claims in ((title, result.claims), ("Our own question", result.questions)):
        table = Table(title=heading, title_justify="left", show_lines=True)
        table.add_column("claim, and by what it is judged")
        table.add_column("verdict", no_wrap=True)
        for claim in report.by_verdict(claims):
            text = f"{escape(claim.text)}\n[dim]{escape(claim.criterion)}[/]"
            table.add_row(text, f"[{COLOURS[claim.verdict]}]{claim.verdict}[/]")
        console.print(table)
        if claims is result.claims:
            console.print(f"{report.summary(claims)} No printed curve was compared with a computed one.")
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
    other = "--decay" if o.decay else "--observer"
    refuse_if(
        o.tolerances and (o.decay or o.observer is not None),
        f"--tolerances and {other} contradict each other.",
        "expected a proof for all tolerances, of the law fed the true state and without a rate of decay, or one "
        "for the nominal robot; got both",
        f"leave out {other}, or --tolerances",
    )
    from flexhinf.certify.certificate import theorem_text
    from flexhinf.design.certification import (
        SAMPLED_ADVICE,
        SeveralJoints,
        certify_design,
        evidence,
        proved,
        without_effect,
    )

    request = request_of(context, o, o.robot, o.elastic)
    idle = without_effect(request.robot, request.specification, o.tolerances)
    for name in stated_options(context) if len(request.robot.joint_names) == 1 else ():
        refuse_if(
            ("peak_effort" if name in PEAKS else name) in idle,
            f"{option_name(name)} has no effect on this certificate.",
            "expected several degrees, or weights that are searched for, which choose the law by such options; "
            f"got one degree {request.specification.degrees}, and no search that runs the step",
            f"leave out {option_name(name)}, or --preset robust",
        )
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
    from flexhinf.certify import load_certificate
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
    certificate = load_certificate(path / CERTIFICATE if path.is_dir() else path)
    with ProofProgress() as bar:
        bar.step("check")
        result = certificate.check(threads=o.threads, sample=None if o.every_cell else 10, tick=bar.cells)
    typer.echo(f"{theorem_text(certificate, result)}\n\n{verification_text(result)}")
    return 0 if result.proved else NOT_MET
