"""``flexhinf certify``: a proved region of a design's law as certificate.json, and its independent check."""

from __future__ import annotations

from pathlib import Path
from shlex import join

import typer

from flexhinf.cli.arguments import reproduce_command, request_of, stated_options, with_options
from flexhinf.cli.messages import NOT_MET, ProofProgress, show
from flexhinf.cli.options import CERTIFY_FIELDS, PEAKS, CertifyOptions
from flexhinf.design.options import option_name
from flexhinf.errors import InvalidInput, refuse_if

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
    from flexhinf import pages
    from flexhinf.certify.theorem import theorem_text
    from flexhinf.design.certification import (
        SAMPLED_ADVICE,
        SeveralJoints,
        certify_design,
        evidence,
        proved,
        without_effect,
    )
    from flexhinf.report import check as check_folder, write

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
    folder = check_folder(o.out)
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
    write(folder, {"index.html": html, CERTIFICATE: result.certificate.text()})
    typer.echo(theorem_text(result.certificate, result.certificate.stated))
    file = folder / CERTIFICATE
    again = join(["flexhinf", "certify", "--check", str(file)])
    typer.echo(f"report:      {folder / 'index.html'}\ncertificate: {file}\ncheck:       {again}")
    return 0


def _check(context: typer.Context, path: Path, o: CertifyOptions) -> int:
    """Check a certificate; nothing but its file is read, so options that state what is to be proved are a mistake."""
    from flexhinf.certify import load_certificate
    from flexhinf.certify.theorem import theorem_text, verification_text

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
