"""``flexhinf certify``: a proved region of a design's law as certificate.json, and its independent check."""

from __future__ import annotations

from pathlib import Path
from shlex import join
from typing import Annotated, Any

import typer

from flexhinf.cli.arguments import (
    Elastic,
    Out,
    Payload,
    PoseXyz,
    Tool,
    reproduce_command,
    request_of,
    with_specification,
)
from flexhinf.cli.messages import NOT_MET, ProofProgress, note
from flexhinf.errors import InvalidInput

#: In the folder that is written.
CERTIFICATE = "certificate.json"

Source = Annotated[
    str,
    typer.Argument(
        help="A robot file, a name that `flexhinf robots` lists, or a design file (design.toml); options win over a "
        "design file.",
        show_default=False,
    ),
]


@with_specification()
def certify(
    context: typer.Context,
    robot: Source = "",
    out: Out = Path("flexhinf-certificate"),
    check: Annotated[
        Path | None,
        typer.Option(
            help="Prove this certificate again, by the independent checker: the file, or the folder of --out.",
            show_default=False,
        ),
    ] = None,
    every_cell: Annotated[
        bool,
        typer.Option(
            "--every-cell",
            help="With --check: prove every cell in rationals and balls too, not a sample of them. Degree 2: minutes; "
            "degree 6: hours.",
        ),
    ] = False,
    degree: Annotated[
        int | None,
        typer.Option(
            help="Degree of V whose certificate is written. Default: the design's.", show_default=False
        ),
    ] = None,
    decay: Annotated[
        float, typer.Option(help="Rate of decay that is proved too: for disturbances that persist, 1/s.")
    ] = 0.0,
    observer: Annotated[
        float | None,
        typer.Option(
            help="Prove output feedback too, with an output-injection observer of this bandwidth, 1/s.",
            show_default=False,
        ),
    ] = None,
    tolerances: Annotated[
        bool,
        typer.Option(
            "--tolerances",
            help="Prove the step of the design for every robot within the tolerances, instead of a region of the "
            "nominal one.",
        ),
    ] = False,
    threads: Annotated[int, typer.Option(help="The certificate does not depend on it.", min=1, max=64)] = 2,
    elastic: Elastic = "",
    payload: Payload = "",
    pose_xyz: PoseXyz = "",
    tool: Tool = "",
    **options: Any,
) -> None:
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
    if every_cell and check is None:
        raise InvalidInput(
            "Every cell is proved twice in a check only.",
            "expected --every-cell with --check FILE, got it without",
            "flexhinf certify --check certificate.json --every-cell",
        )
    if check is not None:
        _refuse_ignored(context, check)
        _check(check, robot, threads, every_cell)
        return
    if not robot:
        raise InvalidInput(
            "Nothing is named to certify.",
            "expected a robot, a design file, or --check FILE, got none of them",
            "flexhinf certify design.toml",
        )
    if tolerances and (decay or observer is not None):
        other = "--decay" if decay else "--observer"
        raise InvalidInput(
            f"--tolerances and {other} contradict each other.",
            "expected a proof for all tolerances, of the law fed the true state and without a rate of decay, or one "
            "for the nominal robot; got both",
            f"leave out {other}, or --tolerances",
        )
    from rich.console import Console

    from flexhinf import pages
    from flexhinf.certify.theorem import theorem_text
    from flexhinf.design.certification import SeveralJoints, certify_design, evidence, proved
    from flexhinf.report import check as check_folder
    from flexhinf.report import write

    request = request_of(context, robot, elastic, payload, pose_xyz, tool).request
    folder = check_folder(out)
    with ProofProgress() as bar:
        try:
            found = certify_design(
                request.robot,
                request.specification,
                bar.step,
                bar.share,
                decay=decay,
                observer=observer,
                tolerances=tolerances,
                threads=threads,
            )
        except SeveralJoints as error:
            raise InvalidInput(error.what, error.found, _sampled_instead(context)) from None
        one = proved(found, degree, tolerances or found[0].box is not None)
        bar.step("pictures, and the worst disturbance")
        shown = evidence(request.robot, request.specification, one)
        html = pages.certificate_page(
            found, one, shown, request.specification, reproduce_command(context)
        ).html()
    for table in pages.certification_tables(found):
        Console().print(table)
    for text in pages.certification_notes(found):
        note(text)
    write(folder, {"index.html": html, CERTIFICATE: shown.certificate.text()})
    typer.echo(theorem_text(shown.certificate, shown.certificate.stated))
    file = folder / CERTIFICATE
    again = join(["flexhinf", "certify", "--check", str(file)])
    typer.echo(f"report:      {folder / 'index.html'}\ncertificate: {file}\ncheck:       {again}")


def _sampled_instead(context: typer.Context) -> str:
    """The command that samples a region of the same request."""
    from flexhinf.design.certification import SAMPLED_ADVICE

    own = ("out", "check", "every_cell", "degree", "degrees", "decay", "observer", "tolerances", "threads")
    words = reproduce_command(context, (*own, "damping", "rays"))
    words[words.index("certify")] = "design"
    return SAMPLED_ADVICE.format(join([*words, "--degrees", "2", "--damping", "0.3", "--rays", "50"]))


def _refuse_ignored(context: typer.Context, path: Path) -> None:
    """A check reads nothing but the file, so options that state what is to be proved are a mistake."""
    used = ("check", "every_cell", "threads", "robot")
    for name in context.params:
        source = context.get_parameter_source(name)
        if name not in used and source is not None and source.name == "COMMANDLINE":
            raise InvalidInput(
                "A certificate is checked as it is.",
                f"expected --check FILE with --every-cell or --threads alone, got --{name.replace('_', '-')}",
                f"flexhinf certify --check {path}",
            )


def _check(path: Path, robot: str, threads: int, every_cell: bool) -> None:
    from flexhinf.certify import load_certificate
    from flexhinf.certify.theorem import theorem_text, verification_text

    if robot:
        raise InvalidInput(
            "A certificate is checked alone.",
            f"expected --check FILE without a robot or a design, got {robot!r}",
            f"flexhinf certify --check {path}",
        )
    certificate = load_certificate(path / CERTIFICATE if path.is_dir() else path)
    with ProofProgress() as bar:
        bar.step("check")
        found = certificate.check(threads=threads, sample=None if every_cell else 10, tick=bar.cells)
    typer.echo(theorem_text(certificate, found))
    typer.echo("")
    typer.echo(verification_text(found))
    if not found.proved:
        raise typer.Exit(NOT_MET)
