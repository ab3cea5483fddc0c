"""The options of every command beside those of a specification, declared once as its fields are.

A command takes the fields of one class here, and of `Specification` those that it computes with.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from flexhinf.design.laws import LARGEST_DEGREE, NL_HINF, RIVALS
from flexhinf.design.specification import FIELDS
from flexhinf.options import (
    ADVANCED,
    CHOICE,
    COMPARED,
    HARDWARE,
    PROVED,
    RUN,
    SAMPLED,
    TRIED,
    WAY,
    WRITTEN,
    CampaignOptions,
    Duration,
    NotNegative,
    Number,
    Period,
    Positive,
    Real,
    Seconds,
    Text,
    Threads,
    Variances,
    Whole,
    argument,
    option,
)
from flexhinf.paper.settings import PaperSettings

ALL = tuple(FIELDS)

#: Fields that a comparison does not compute with: what only the design is judged by, and its region.
NOT_COMPARED = ("workspace", "tracking_error", "compare_rigid", "mujoco", "rays", "checked_gamma_ratio")
COMPARE_FIELDS = tuple(name for name in FIELDS if name not in NOT_COMPARED)

#: Fields of runs by which no law is chosen, and of a sampled region: a certificate says nothing of them.
NOT_CERTIFIED = (
    "workspace", "tracking_error", "angle_unit", "load", "rays", "compare_rigid", "mujoco", "undershoot",
    "path_distance", "remaining_error",
)  # fmt: skip
CERTIFY_FIELDS = tuple(name for name in FIELDS if name not in NOT_CERTIFIED)

#: Fields that change a run and not its controller.
RUN_FIELDS = (
    "pose", "start", "shaping", "feedforward", "move", "tracking_error", "undershoot", "path_distance",
    "remaining_error", "ripple", "overshoot", "angle_unit", "extras", "unknown_delay",
    "quantisation",     "measurement_noise", "load", "duration", "seed",
)  # fmt: skip

#: Fields that a filter for a log is made of.
ESTIMATE_FIELDS = ("measured", "extras", "period", "process_noise", "torque_noise", "measurement_noise")

#: Fields that the model of an identification is made of.
IDENTIFY_FIELDS = ("measured", "extras")

#: An option of its own for the largest input by the kind of drive, beside ``--peak-effort``.
PEAKS = {
    "peak_voltage": ("voltage", "V"),
    "peak_current": ("current", "A"),
    "peak_torque": ("torque", "N·m or N"),
}

CONTROLLER = (
    "design.toml, the folder of a report, or the file of a controller. The controller of a report is taken as it was "
    "judged; a design.toml without one is designed first."
)
DESIGN = "design.toml, the folder of a report, or a robot as for `flexhinf design`."
FOLDER = "Folder of the report; an earlier report there is replaced whole."


# fmt: off
@dataclass(frozen=True, kw_only=True)
class PointOptions:
    """Options for the payload, and for a goal of a point of the robot."""

    payload: Text = option("", HARDWARE,
        "What the robot carries: 2kg, 0kg (an empty hand), a range 0..3kg (nominal at its lower end) or 0..1..3kg; "
        "@LINK where, :x,y,z its centre of mass there (m). Default: the file's own.", "2kg", "kg@link")
    pose_xyz: Text = option("", WAY,
        "Goal of a point of the robot in the world, instead of --pose: 0.4,0,0.3 (m) or 400mm,0,300mm. The joints are "
        "found for it; out of reach is refused, near a singular pose there is a note.", "0.4,0,0.3", "x,y,z")
    tool: Text = option("", WAY,
        "The point that --pose-xyz, --workspace x=0.2:0.5, and waypoints with columns x, y, z, are for: LINK:x,y,z, by "
        "the name of the link's joint, in the link's frame (m). Default: the origin of the last link.",
        "hand:0,0,0.1", "link:x,y,z")


@dataclass(frozen=True, kw_only=True)
class ElasticOptions:
    """The option that goes with a robot whose links another file states."""

    elastic: Text = option("", HARDWARE,
        "With a URDF or MJCF: the robot file with spring and motor of each joint.")


@dataclass(frozen=True, kw_only=True)
class RequiredOptions:
    """The option for what every run of a campaign must keep."""

    require: list[Text] = option(list, TRIED,
        "What a run must keep to count as a success; again for more. Default: it settles and keeps the limits of the "
        "design.", "overshoot_percent<=5", "metric<=x")


@dataclass(frozen=True, kw_only=True)
class RobotOptions(ElasticOptions, PointOptions):
    """Options of commands that take a robot or a design file, whose values other options replace."""

    robot: Text = argument(
        "A robot file (arm.toml), a URDF, an MJCF file (arm.xml), a name that `flexhinf robots` lists, or a design "
        "file (design.toml); options win over a design file.")


@dataclass(frozen=True, kw_only=True)
class DesignOptions(RobotOptions):
    """Options of ``flexhinf design``."""

    out: Path = option(Path("flexhinf-design"), WRITTEN, FOLDER)


@dataclass(frozen=True, kw_only=True)
class CompareOptions(RobotOptions):
    """Options of ``flexhinf compare``."""

    out: Path = option(Path("flexhinf-compare"), WRITTEN, FOLDER)
    laws: Text = option("", COMPARED,
        f"{NL_HINF}, {NL_HINF}-2 … {NL_HINF}-{LARGEST_DEGREE} (degree of V), {', '.join(RIVALS)}; between commas. "
        "Default: all without a degree.", "pd,pid")
    tune: Text = option("peak", COMPARED,
        "What the laws share when they are tuned: peak (largest input of the step as deployed: at most the limit asked "
        "for or the saturation, or that of the design where it is larger), bandwidth (of the linear loop: at most the "
        "one asked for, or that of the design), or none. Every law keeps the limits of the margins as well, and lets "
        "no more measurement noise through to the motor than the design.", "bandwidth")
    same_sensors: bool = option(False, COMPARED,
        "Every law measures what the design measures; without this option each law has the sensors that its proponents "
        "would choose, such as an encoder on the motor for a PD.")


@dataclass(frozen=True, kw_only=True)
class CertifyOptions(RobotOptions):
    """Options of ``flexhinf certify``."""

    robot: Text = argument(
        "A robot file, a name that `flexhinf robots` lists, or a design file (design.toml); options win over a design "
        "file.", default="")
    out: Path = option(Path("flexhinf-certificate"), WRITTEN, FOLDER)
    check: Path | None = option(None, PROVED,
        "Prove this certificate again, by the independent checker: the file, or the folder of --out.", unit="path")
    every_cell: bool = option(False, PROVED,
        "With --check: prove every cell in rationals and balls too, not a sample of them. Degree 2: minutes; degree 6: "
        "hours.")
    degree: Whole | None = option(None, PROVED,
        "Degree of V whose certificate is written.", "4", default="the design's")
    decay: Real = option(0.0, PROVED,
        "Rate of decay that is proved too: for disturbances that persist, 1/s.", "0.1", "1/s")
    observer: Positive | None = option(None, PROVED,
        "Prove output feedback too, with an output-injection observer of this bandwidth, 1/s.", "10", "1/s",
        default="the true state is fed back")
    tolerances: bool = option(False, PROVED,
        "Prove the step of the design for every robot within the tolerances, instead of a region of the nominal one.")
    threads: Threads = option(2, ADVANCED, "The certificate does not depend on it.", "2")


@dataclass(frozen=True, kw_only=True)
class BatchOptions(ElasticOptions, RequiredOptions, CampaignOptions):
    """Options that a campaign and a comparison of two campaigns share."""

    tolerance: list[Text] = option(list, SAMPLED,
        "Another tolerance of a parameter of the robot: stiffness=15% or mass=0.9..1.2; again for more.",
        "stiffness=15%", "name=x")
    workers: Whole = option(0, RUN, "Processes beside this one; 0: this one alone, with two threads.", "4")
    cluster: Text = option("", RUN, "Address of a scheduler of Dask's, whose workers run the batches.", unit="tcp://…")
    shard: Text = option("", RUN, "Every n-th batch only, for one of n jobs; then `merge`.", "1/4", "i/n")


@dataclass(frozen=True, kw_only=True)
class RunCampaignOptions(BatchOptions):
    """Options of ``flexhinf campaign``."""

    design: Text = argument(
        f"{DESIGN} The controller of a report is taken as it was judged; without one it is designed first.", "DESIGN")
    out: Path = option(Path("flexhinf-campaign"), WRITTEN, "Folder of the campaign; the same command goes on there.")
    worst_case: bool = option(False, TRIED,
        "Then search the box of tolerances for the worst robot, and say how much worse than the worst sample it is.")
    metric: list[Text] = option(list, TRIED,
        "What --worst-case makes as large as it can, `gain` for the worst disturbance; again for more. Default: all "
        "that a requirement limits, and gain.", "gain")
    starts: Whole = option(8, TRIED, "Searches of --worst-case for each metric.", "8")


@dataclass(frozen=True, kw_only=True)
class CompareCampaignsOptions(BatchOptions):
    """Options of ``flexhinf campaign compare``."""

    first: Text = argument(DESIGN)
    second: Text = argument(DESIGN)
    out: Path = option(Path("flexhinf-pair"), WRITTEN, "Folder of the comparison; the same command goes on there.")


@dataclass(frozen=True, kw_only=True)
class MergeOptions(RequiredOptions):
    """Options of ``flexhinf campaign merge``."""

    folder: Path = argument("The folder of a campaign.", "DIR")
    others: list[Path] = argument("Folders with other shards of the same campaign.", "[DIR…]", default=())


@dataclass(frozen=True, kw_only=True)
class ReplayOptions:
    """Options of ``flexhinf campaign replay``."""

    folder: Path = argument("The folder of a campaign.", "DIR")
    sample: Whole | None = option(None, TRIED, "Its number in the table.", "123")
    worst_case: Text = option("", TRIED,
        "Instead of a sample: the robot that --worst-case found for this metric.", unit="metric")
    out: Path | None = option(None, WRITTEN, "Write all signals: run.csv or run.nc.", unit="path")


@dataclass(frozen=True, kw_only=True)
class ExportCOptions:
    """Options of ``flexhinf export c``."""

    source: Text = argument(CONTROLLER, "DESIGN")
    out: Path = option(Path("flexhinf-c"), WRITTEN, "A new or empty folder.")
    name: Text = option("", WRITTEN, "A C identifier: of the files, and the beginning of all names.", "arm")
    real: Annotated[Literal["double", "float"], CHOICE] = option("double", HARDWARE,
        "Type of all numbers: double or float.", "float")
    period: Text = option("", HARDWARE,
        "Period of your firmware's loop; refused if it is not the design's.", "1ms", "s")
    flash: Text = option("", HARDWARE,
        "Room for code and constants, such as 32kB; refused if they need more. The code is counted for a Cortex-M4F, "
        "where arm-none-eabi-gcc is installed; elsewhere a note says that only constants were.", "32kB")
    ram: Text = option("", HARDWARE, "Room for the state, such as 8kB; refused if it needs more.", "8kB")
    force: bool = option(False, WRITTEN, "Write into a folder that is not empty.")


@dataclass(frozen=True, kw_only=True)
class ExportFmuOptions:
    """Options of ``flexhinf export fmu``."""

    source: Text = argument(CONTROLLER, "DESIGN")
    out: Path = option(Path("flexhinf.fmu"), WRITTEN, "The file that is written.")
    name: Text = option("", WRITTEN, "A C identifier: the model's name.", "arm")
    plant: bool = option(False, WRITTEN, "The elastic robot instead of the controller, with the design's extras.")


@dataclass(frozen=True, kw_only=True)
class CompileOptions:
    """Options of ``flexhinf compile``."""

    source: Text = argument(CONTROLLER, "DESIGN")
    out: Path = option(Path("flexhinf-controller.so"), WRITTEN, "The file that is written.")
    processor: Annotated[Literal["portable", "any", "native"], CHOICE] = option("portable", HARDWARE,
        "On which it runs: portable (PCs since about 2015), any (older ones too, ten times slower), or native (those "
        "that have all that this one has). Others refuse it.", "native")


@dataclass(frozen=True, kw_only=True)
class RunOptions(PointOptions):
    """Options of ``flexhinf run``."""

    source: Text = argument(
        "design.toml or the folder of a report, whose controller is taken as it was judged; a design.toml without one "
        "is designed first.", "DESIGN")
    mujoco: bool = option(False, HARDWARE, "Drive the elastic robot in MuJoCo (needs flexhinf[mujoco]).")
    library: Path | None = option(None, HARDWARE,
        "Step this shared library of `flexhinf compile` instead of the controller in Python.", unit="path")
    perturb: list[Text] = option(list, HARDWARE,
        "Another number in the robot that is driven: stiffness=-20%, friction_elbow=0.4. Several times.",
        "stiffness=-20%", "name=value")
    load: Number | None = option(None, TRIED, "Torque on every link from --load-at on: 0.5.", "0.5",
        "N·m or N", default="none")
    load_at: Seconds | None = option(None, TRIED, "When the load begins.", "1s", "s", default="in the middle")
    noise: bool = option(True, HARDWARE, "Whether measurements have noise.")
    duration: Duration | None = option(None, RUN, "Length of the run: 3s.", "3s", "s",
        zero="the default", default="that of the design file, or 5 s; of a move its time and half of it again")
    realtime: bool = option(True, RUN, "Whether samples wait for the clock, or follow each other as fast as possible.")
    priority: Whole | None = option(None, RUN, "Of SCHED_FIFO, 1 to 99, where the system permits it.", "80",
        default="none")
    core: Whole | None = option(None, RUN, "Processor core that the loop is kept on.", "1", default="any")
    view: bool = option(False, WRITTEN, "Show the robot in MuJoCo's viewer meanwhile.")
    log: list[Path] = option(list, WRITTEN,
        "Write everything to a file: .csv or .parquet (PlotJuggler), .mcap (Foxglove). Several times.", "run.csv",
        "path")
    record: list[Path] = option(list, WRITTEN,
        "Write a film of links and motors: .mp4 or .gif. Several times.", "arm.gif", "path")


@dataclass(frozen=True, kw_only=True)
class LogOptions(ElasticOptions):
    """Options of the commands that read a log."""

    log: Path = argument(
        "A log: .csv (a header, rows of numbers), .parquet, or .mcap (JSON, ROS 2).", "LOG")
    robot: Text = option("", HARDWARE,
        "A robot file (arm.toml), a URDF, an MJCF file, a name that `flexhinf robots` lists, or a design, of which the "
        "filter has sensors and noise levels then.", "arm.toml", "ROBOT")
    payload: Text = option("", HARDWARE, "What the robot carries, as for `flexhinf design`: 2kg.", "2kg", "kg@link")
    column: list[Text] = option(list, HARDWARE,
        "The column of a signal that has another name in the log: motor_position=pos, with its unit "
        "\"motor_position=pos [deg]\" or what one is in the SI unit \"motor_position=counts [0.00153]\"; "
        "state.link_position is a true state, which errors are compared with; again for more.",
        "motor_position=pos", "signal=column")
    time: Text = option("", HARDWARE,
        "The column of times, where it is called neither time, t, timestamp nor stamp, or has a unit that is not in "
        "its name: \"stamp [ms]\".", "stamp", "column")
    hold_inputs: bool = option(False, HARDWARE, "An input acts until the next one: rows without it are no mistake.")
    latency: Whole | None = option(None, HARDWARE,
        "Samples from the row of an input to the row from which on it acts: 1 where a controller logs what it sends "
        "and it acts a sample later, as in logs of `flexhinf run`.", "1", "samples", default="that of the design, or 0")


@dataclass(frozen=True, kw_only=True)
class EstimateOptions(LogOptions):
    """Options of ``flexhinf estimate``."""

    period: Period | None = option(None, ADVANCED,
        "Longest prediction in one piece, and what --process-noise and --torque-noise are per: 0.001 (s) or 1ms.",
        "1ms", "s", default="that of the design, or the median time between rows")
    process_noise: NotNegative | None = option(None, ADVANCED,
        "q of R^v = q I, the variance added to every state per period.", "1e-10",
        default="that of the design, or none")
    torque_noise: NotNegative | None = option(None, ADVANCED,
        "Variance added to the velocities alone per period, where unknown torques act.", "1e-7",
        default="that of the design, or of torques of 1 % of the input")
    measurement_noise: Variances | None = option(None, ADVANCED,
        "R^n, the variance of a measured angle, or one per name of --measured, or per measured signal, each in its own "
        "unit: 1e-8,0.01.", "1e-8", "rad²", default="that of the design, or from differences of neighbouring rows")
    filter: Annotated[Literal["unscented", "extended"], CHOICE] = option("unscented", HARDWARE,
        "unscented or extended.", "extended")
    form: Annotated[Literal["square_root", "covariance"], CHOICE] = option("square_root", ADVANCED,
        "What the filter computes with: square_root or covariance.", "covariance")
    smooth: bool = option(False, WRITTEN,
        "Estimates from all samples too, before and after (Rauch, Tung and Striebel): columns `smoothed`.")
    table: Annotated[Literal["csv", "parquet"], CHOICE] = option("csv", WRITTEN,
        "How estimates are written: csv or parquet.", "parquet")
    out: Path = option(Path("flexhinf-estimate"), WRITTEN, FOLDER)


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions(LogOptions):
    """Options of ``flexhinf identify``."""

    parameters: Text = option("", HARDWARE,
        "Numbers of the robot's file: stiffness for all joints, stiffness_elbow for one.", "stiffness,friction", "LIST")
    motion: Seconds = option(10.0, WRITTEN,
        "Longest duration of the motion that is proposed where the log does not tell a number.", "5", "s")
    seed: Whole = option(0, WRITTEN, "Seed of the motions that are tried.", "1")
    out: Path = option(Path("flexhinf-identify"), WRITTEN, FOLDER)


@dataclass(frozen=True, kw_only=True)
class PaperOptions(PaperSettings):
    """Options of ``flexhinf paper``."""

    out: Path = option(Path("flexhinf-paper"), WRITTEN, FOLDER)
# fmt: on
