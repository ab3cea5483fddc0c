"""The room's public names and the files that they come from; read when a name is first used."""

from .blocks import (
    Bullets as Bullets,
    Cell as Cell,
    Column as Column,
    Figure as Figure,
    Listing as Listing,
    Note as Note,
    PageBlock as PageBlock,
    Paragraph as Paragraph,
    Table as Table,
    finite as finite,
    to_json as to_json,
)
from .facts import Fact as Fact, Provenance as Provenance, Settings as Settings, versions as versions
from .figure import (
    GRID as GRID,
    INK as INK,
    MUTED as MUTED,
    SERIES as SERIES,
    WIDTH as WIDTH,
    Film as Film,
    LineStyle as LineStyle,
    figure_to_svg as figure_to_svg,
    fitted as fitted,
    house_style as house_style,
    label as label,
    legend as legend,
    new_figure as new_figure,
    panels as panels,
    quantile_band as quantile_band,
    reference_line as reference_line,
    settling_band as settling_band,
    time_response as time_response,
)
from .folder import (
    check as check,
    contents as contents,
    is_listed as is_listed,
    is_report as is_report,
    sources as sources,
    unchanged as unchanged,
    write as write,
    written_on as written_on,
)
from .page import (
    Badge as Badge,
    Claims as Claims,
    Drawing as Drawing,
    JudgedClaim as JudgedClaim,
    Page as Page,
    Section as Section,
    Verdict as Verdict,
    by_verdict as by_verdict,
    summary as summary,
    with_figures as with_figures,
)
