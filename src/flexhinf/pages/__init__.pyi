"""The room's public names and the files that they come from; read when a name is first used."""

from .campaign import write_campaign as write_campaign
from .campaign_pair import (
    pair_designs as pair_designs,
    pair_table as pair_table,
    pair_verdict as pair_verdict,
    write_pair as write_pair,
)
from .campaign_text import (
    campaign_design as campaign_design,
    campaign_verdict as campaign_verdict,
    gain_replay_table as gain_replay_table,
    gain_text as gain_text,
    journal_design as journal_design,
    metric_text as metric_text,
    missed_by as missed_by,
    replay_command as replay_command,
    replay_table as replay_table,
    worst_table as worst_table,
    worst_text as worst_text,
)
from .certificate import (
    certificate_page as certificate_page,
    certification_ending as certification_ending,
    certification_notes as certification_notes,
    certification_tables as certification_tables,
    check_text as check_text,
)
from .checks import (
    check_ending as check_ending,
    checked_log as checked_log,
    checked_robot as checked_robot,
    finding_texts as finding_texts,
)
from .comparison import (
    comparison_details as comparison_details,
    comparison_ending as comparison_ending,
    comparison_page as comparison_page,
    comparison_verdict as comparison_verdict,
)
from .drawing import left_out_notes as left_out_notes
from .estimate import (
    estimate_file as estimate_file,
    estimate_page as estimate_page,
    judgement as judgement,
)
from .estimate_figures import FilteredLog as FilteredLog
from .files import (
    EarlyParts as EarlyParts,
    comparison_files as comparison_files,
    design_files as design_files,
    design_text as design_text,
    details as details,
    ending as ending,
    write_report as write_report,
)
from .film import check_film as check_film, write_film as write_film
from .identify import IdentifiedRobot as IdentifiedRobot, identified_page as identified_page
from .page import (
    actuators_table as actuators_table,
    design_page as design_page,
    design_tables as design_tables,
    gears_table as gears_table,
    notes as notes,
    report_files as report_files,
    robots_table as robots_table,
    verdict as verdict,
)
from .paper import PaperDrawings as PaperDrawings, paper_files as paper_files
from .run import (
    run_ending as run_ending,
    run_files as run_files,
    run_met as run_met,
    run_notes as run_notes,
    run_tables as run_tables,
    run_verdict as run_verdict,
)
from .terminal import SCREEN as SCREEN, page_ending as page_ending, wrapped as wrapped
from .workspace_check import pair_text as pair_text
from .workspace_parts import PROOF_FILE as PROOF_FILE
from .workspace_proof import (
    workspace_proof_ending as workspace_proof_ending,
    workspace_proof_numbers as workspace_proof_numbers,
    workspace_proof_page as workspace_proof_page,
)
from .workspace_summary import workspace_verdict as workspace_verdict
