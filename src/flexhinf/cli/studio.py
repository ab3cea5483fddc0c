"""``flexhinf studio``: tuning by hand, in the browser."""

from __future__ import annotations

import typer

from flexhinf.cli.arguments import with_options
from flexhinf.cli.messages import note, options
from flexhinf.validation import extra_package


@with_options(lambda: (options.StudioOptions, ()))
def studio(context: typer.Context, o: options.StudioOptions) -> None:
    """Tune a design by hand, in the browser: sliders, and the step of 200 robots beside them.

    The arm moves with link and motor apart. Designs are loaded from and saved to
    the working folder as TOML, which `flexhinf design` takes; C, an FMU and the
    report are written there too. It answers at 127.0.0.1 alone, who has the
    address that it prints, until Ctrl-C. Needs flexhinf[studio].
    """
    extra_package("nicegui", "studio", "The studio is not installed.")
    from flexhinf.studio.server import listening, serve
    from flexhinf.studio.session import opened

    if o.port:
        listening(o.port).close()  # before the robot is read
    request = opened(o.robot, o.elastic)
    for text in (*request.notes, *request.warnings):
        note(text)
    serve(request, port=o.port, browser=o.browser, say=typer.echo)
    typer.echo("studio: ended")
