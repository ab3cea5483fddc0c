"""Figures, tables, one self-contained HTML page, and the folder they are written to as a whole."""

from flexhinf.report.blocks import (
    Block,
    Bullets,
    Figure,
    Listing,
    Note,
    Paragraph,
    Provenance,
    Setting,
    Settings,
    at_least,
    at_most,
    number,
    to_json,
    versions,
)
from flexhinf.report.figure import (
    GRID,
    INK,
    MUTED,
    SERIES,
    WIDTH,
    figure_to_svg,
    house_style,
    label,
    legend,
    new_figure,
    quantile_band,
    reference_line,
    settling_band,
    time_response,
)
from flexhinf.report.folder import check, is_report, unchanged, write
from flexhinf.report.page import (
    Claim,
    ClaimEvidence,
    Claims,
    KeyNumber,
    Page,
    Section,
    Status,
    by_verdict,
    summary,
)
from flexhinf.report.table import Cell, Column, Table

__all__ = [
    "GRID", "INK", "MUTED", "SERIES", "WIDTH", "Block", "Bullets", "Cell", "Claim", "ClaimEvidence", "Claims",
    "Column", "Figure", "KeyNumber", "Listing", "Note", "Page", "Paragraph", "Provenance", "Section",
    "Setting", "Settings", "Status", "Table", "at_least", "at_most", "by_verdict", "check", "figure_to_svg",
    "house_style", "is_report", "label", "legend", "new_figure", "number", "quantile_band", "reference_line",
    "settling_band", "summary", "time_response", "to_json", "unchanged", "versions", "write",
]  # fmt: skip
