"""The report of a design and of a comparison: pages, numbers, files and terminal tables. Computes nothing."""

from flexhinf.pages.campaign import write_campaign
from flexhinf.pages.campaign_pair import pair_table, pair_verdict, write_pair
from flexhinf.pages.campaign_text import (
    campaign_verdict,
    gain_replay_table,
    gain_text,
    metric_text,
    missed_by,
    replay_command,
    replay_table,
    worst_table,
    worst_text,
)
from flexhinf.pages.certificate import certificate_page
from flexhinf.pages.comparison import comparison_notes, comparison_page, comparison_verdict
from flexhinf.pages.design.laws import comparison_tables
from flexhinf.pages.files import comparison_files, design_files, write_comparison, write_design
from flexhinf.pages.page import (
    certification_notes,
    certification_tables,
    design_page,
    design_tables,
    notes,
    robots_table,
    verdict,
)
from flexhinf.pages.run import check_film, run_met, run_notes, run_tables, run_verdict, write_film

__all__ = [
    "campaign_verdict", "certificate_page", "certification_notes", "certification_tables",
    "check_film", "comparison_files", "comparison_notes", "comparison_page", "comparison_tables",
    "comparison_verdict", "design_files", "design_page", "design_tables", "gain_replay_table", "gain_text",
    "metric_text", "missed_by", "notes", "pair_table", "pair_verdict", "replay_command",
    "replay_table", "robots_table", "run_met", "run_notes", "run_tables", "run_verdict",
    "verdict", "worst_table", "worst_text", "write_campaign", "write_comparison", "write_design", "write_film",
    "write_pair",
]  # fmt: skip
