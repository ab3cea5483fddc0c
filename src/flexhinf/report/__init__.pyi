"""The room's public names and the files that they come from; read when a name is first used."""

from .blocks import (
    Block as Block,
    Bullets as Bullets,
    Cell as Cell,
    Column as Column,
    Figure as Figure,
    Listing as Listing,
    Note as Note,
    Paragraph as Paragraph,
    Provenance as Provenance,
    Setting as Setting,
    Settings as Settings,
    Table as Table,
    at_least as at_least,
    at_most as at_most,
    finite as finite,
    number as number,
    to_json as to_json,
    versions as versions,
)
from .figure import (
    GRID as GRID,
    INK as INK,
    MUTED as MUTED,
    SERIES as SERIES,
    WIDTH as WIDTH,
    figure_to_svg as figure_to_svg,
    house_style as house_style,
    label as label,
    legend as legend,
    new_figure as new_figure,
    quantile_band as quantile_band,
    reference_line as reference_line,
    settling_band as settling_band,
    time_response as time_response,
)
from .folder import check as check, is_report as is_report, unchanged as unchanged, write as write
from .page import (
    Claim as Claim,
    Claims as Claims,
    KeyNumber as KeyNumber,
    Page as Page,
    Section as Section,
    Status as Status,
    by_verdict as by_verdict,
    summary as summary,
)
