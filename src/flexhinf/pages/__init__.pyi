"""The room's public names and the files that they come from; read when a name is first used."""

from .bode import bode_figure as bode_figure
from .campaign import write_campaign as write_campaign
from .campaign_numbers import metric_text as metric_text
from .campaign_parts import (
    campaign_design as campaign_design,
    campaign_verdict as campaign_verdict,
    gain_replay_table as gain_replay_table,
    gain_text as gain_text,
    journal_design as journal_design,
    missed_by as missed_by,
    pair_designs as pair_designs,
    pair_table as pair_table,
    pair_verdict as pair_verdict,
    replay_command as replay_command,
    replay_table as replay_table,
    worst_table as worst_table,
    worst_text as worst_text,
    write_pair as write_pair,
)
from .certificate import (
    certificate_page as certificate_page,
    certification_ending as certification_ending,
    certification_notes as certification_notes,
    certification_tables as certification_tables,
    check_text as check_text,
)
from .comparison import (
    comparison_notes as comparison_notes,
    comparison_page as comparison_page,
    comparison_tables as comparison_tables,
    comparison_verdict as comparison_verdict,
)
from .drawing import left_out_notes as left_out_notes
from .estimate import (
    estimate_ending as estimate_ending,
    estimate_files as estimate_files,
    judgement as judgement,
)
from .estimate_figures import FilteredLog as FilteredLog
from .files import (
    PROOF_FILE as PROOF_FILE,
    EarlyParts as EarlyParts,
    compared_details as compared_details,
    compared_ending as compared_ending,
    comparison_files as comparison_files,
    design_files as design_files,
    design_text as design_text,
    details as details,
    ending as ending,
    write_report as write_report,
)
from .film import check_film as check_film, write_film as write_film
from .identify import (
    IdentifiedRobot as IdentifiedRobot,
    identified_ending as identified_ending,
    identified_files as identified_files,
)
from .log_findings import (
    checked_log_ending as checked_log_ending,
    checked_log_files as checked_log_files,
    checked_log_page as checked_log_page,
    finding_texts as finding_texts,
)
from .page import (
    actuators_table as actuators_table,
    design_page as design_page,
    design_tables as design_tables,
    gears_table as gears_table,
    notes as notes,
    robots_table as robots_table,
    verdict as verdict,
)
from .pictures import notebook_pictures as notebook_pictures
from .robot_check import (
    checked_robot_ending as checked_robot_ending,
    checked_robot_files as checked_robot_files,
    checked_robot_page as checked_robot_page,
)
from .run import (
    run_ending as run_ending,
    run_files as run_files,
    run_met as run_met,
    run_notes as run_notes,
    run_tables as run_tables,
    run_verdict as run_verdict,
)
from .terminal import SCREEN as SCREEN, wrapped as wrapped
from .workspace_check import pair_text as pair_text
from .workspace_proof import (
    workspace_proof_ending as workspace_proof_ending,
    workspace_proof_numbers as workspace_proof_numbers,
    workspace_proof_page as workspace_proof_page,
)
from .workspace_summary import workspace_verdict as workspace_verdict
