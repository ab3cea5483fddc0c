"""The folder of a design's campaign: controller and design file, written once, and the campaign made of them again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import tomlkit

from flexhinf.campaign import Campaign, Journal
from flexhinf.design.campaign_setup import CampaignOptions, DesignCampaign, fields_text
from flexhinf.design.design_file import load_design, read_request
from flexhinf.design.design_file_text import request_document
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.hunting import brought_to_rest
from flexhinf.design.laws import DESIGN
from flexhinf.design.pipeline import step_duration
from flexhinf.design.synthesis import synthesise
from flexhinf.errors import InvalidInput
from flexhinf.files import locked, write_file
from flexhinf.loop import Controller, load_controller
from flexhinf.report import unchanged
from flexhinf.untrusted import read_toml

__all__ = ["open_campaign", "stored_campaign"]

#: Folder of the design file and the controller inside a campaign's, and their names.
SETUP, DESIGN_FILE, CONTROLLER = "setup", "design.toml", "controller"

#: How long a driver waits for another one that designs the controller, s.
PATIENCE = 3600.0


def open_campaign(
    asked: DesignCampaign,
    folder: str | Path,
    command: Sequence[str] = (),
    progress: Callable[[str], None] = print,
) -> tuple[Campaign, Journal]:
    """The campaign in a folder: designed and written there, or taken up again with the controller that is there.

    Parameters
    ----------
    asked : DesignCampaign
    folder : path
    command : sequence of str
        That made it, for its reports.
    progress : callable
        Called with what comes next while the controller is designed.

    Raises
    ------
    InvalidInput
        Before any work, if the folder holds something else, or a campaign with other settings.
    FlexhinfError
        As `flexhinf.design.design`.
    """
    _ = asked.stated  # refuses what does not fit
    journal = Journal.read(folder, (SETUP,))
    place = Path(folder).expanduser().absolute()
    if journal is None:
        (place / SETUP).mkdir(parents=True, exist_ok=True)
        with locked(place / ".campaign-setup-lock", PATIENCE):
            journal = Journal.read(folder, (SETUP,))  # another driver of a job array may have been quicker
            if journal is None:
                return _begun(asked, place, command, progress)
    journal.refuse_other(asked.stated, partly=True)
    campaign = reopened(asked, journal)
    journal.refuse_other(campaign.settings)
    return campaign, journal


def _begun(
    asked: DesignCampaign, place: Path, command: Sequence[str], progress: Callable[[str], None]
) -> tuple[Campaign, Journal]:
    """Design the controller and write what makes the campaign again; the manifest comes last."""
    controller, duration = _controller(asked, progress)
    duration = duration if asked.options.duration is None else asked.options.duration
    asked.campaign(controller, duration)  # refuses what does not fit before anything is written
    document = request_document(
        asked.specification, asked.request.source, asked.request.elastic, place / SETUP, asked.request.payload,
        asked.request.robot.links.slides,
    )  # fmt: skip
    text = tomlkit.dumps(document)
    write_file(
        place / SETUP / DESIGN_FILE, "design file", lambda name: Path(name).write_text(text, encoding="utf-8")
    )
    controller.save(place / SETUP / CONTROLLER)
    campaign = asked.campaign(load_controller(place / SETUP / CONTROLLER), duration)
    o = asked.options
    about = {
        "title": f"Campaign of the robot “{asked.request.robot.name}”", "requirements": list(asked.requirements),
        "nominal": asked.nominal, "options": {**vars(o), "tolerances": [list(one) for one in o.tolerances]},
    }  # fmt: skip
    return campaign, Journal.opened(place, campaign, command, about)


def _controller(asked: DesignCampaign, progress: Callable[[str], None]) -> tuple[Controller, float]:
    """The controller and the length of its step, s: of a report that nobody changed, or designed now."""
    path = asked.file
    if path is not None and path.name == DESIGN_FILE and unchanged(path.parent, (DESIGN_FILE, CONTROLLER)):
        length = read_toml(path, "design file").get("result", {}).get("duration")
        if isinstance(length, float) and fields_text(load_design(path)[1]) == fields_text(
            asked.specification
        ):
            return load_controller(path.parent / CONTROLLER), length
    robot, s = asked.request.robot, asked.specification
    synthesis = synthesise(robot, s, progress)
    setup = brought_to_rest(synthesis.setup(robot, s))[0]
    return setup.bumpless_controller, step_duration(LawEvaluation(DESIGN, setup), synthesis)


def reopened(asked: DesignCampaign, journal: Journal) -> Campaign:
    """The campaign of a folder, with the controller that is there."""
    controller = load_controller(journal.folder / SETUP / CONTROLLER)
    return asked.campaign(controller, float(journal.settings["duration"]))


def stored_campaign(folder: str | Path) -> tuple[Campaign, Journal]:
    """The campaign of a folder as it stands there, for replays: nothing is asked for beside it.

    Raises
    ------
    InvalidInput
        If the folder holds no campaign of a design, or the robot's file was changed since.
    """
    journal = Journal.read(folder)
    if journal is None or "options" not in journal.about:
        raise InvalidInput(
            "The folder holds no campaign of a design.",
            f"expected a folder that `flexhinf campaign` wrote, got {folder}",
            "its --out; a campaign from Python replays with Campaign(...).replay(sample)",
        )
    known = CampaignOptions.__dataclass_fields__
    stored = {name: value for name, value in journal.about["options"].items() if name in known}
    stored["tolerances"] = tuple((name, spread) for name, spread in stored["tolerances"])
    asked = DesignCampaign(read_request(journal.folder / SETUP / DESIGN_FILE), CampaignOptions(**stored))
    journal.refuse_other(asked.stated, partly=True)
    return reopened(asked, journal), journal
