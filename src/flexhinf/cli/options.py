"""The options of every command beside those of a specification, declared once as its fields are.

A command takes the fields of one class here, and of `Specification` those that it computes with.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from flexhinf.designs.campaign_options import CampaignOptions
from flexhinf.designs.laws import LAWS, NL_HINF
from flexhinf.designs.requirements.kinds import REQUIREMENTS
from flexhinf.designs.specification import FIELDS
from flexhinf.extensions import load_extensions
from flexhinf.options import (
    ADVANCED,
    CHOICE,
    COMPARED,
    LOGGED,
    LOOP,
    PROVED,
    ROBOT,
    RUN,
    SEARCH,
    SENSORS,
    TARGET,
    UNCERTAIN,
    WAY,
    WRITTEN,
    Allowed,
    Duration,
    Flag,
    NotNegative,
    Number,
    Period,
    Positive,
    Probability,
    Quanta,
    Real,
    Seconds,
    Text,
    Threads,
    Variances,
    Whole,
    argument,
    choice,
    option,
    read_by,
)
from flexhinf.paper.settings import PaperSettings
from flexhinf.robot.drives import DRIVES
from flexhinf.validation import one_of

load_extensions()  # whose requirements and laws have options too
ALL = tuple(FIELDS)

#: Fields of runs by which no law is chosen, and of a sampled region: a certificate says nothing of them.
NOT_CERTIFIED = ("workspace", "angle_unit", "load", "rays", "mujoco")
LIMITS = [kind for kind in REQUIREMENTS.values() if kind.info is not None]
JUDGING = [kind.field for kind in LIMITS if not kind.searched]
CERTIFY_FIELDS = tuple(name for name in FIELDS if name not in (*NOT_CERTIFIED, *JUDGING))

#: Fields that change a run and not its controller.
RUN_FIELDS = (
    "pose", "start", "shaping", "feedforward", "move", "angle_unit", "extras", "unknown_delay", "quantisation",
    "measurement_noise", "load", "duration", "seed", *(kind.field for kind in LIMITS if kind.of_motion is not None),
)  # fmt: skip

#: Fields that a filter for a log is made of.
ESTIMATE_FIELDS = ("measured", "extras", "period", "process_noise", "torque_noise", "measurement_noise")

#: Fields that a log is checked with, and a robot's description.
CHECK_FIELDS = ("measured", "period")

#: Fields that the model of an identification is made of.
IDENTIFY_FIELDS = (
    "measured", "extras", "process_noise", "torque_noise", "measurement_noise", "quantisation",
)  # fmt: skip

#: Where a command has more than `SEVERAL` options, its help shows these fields and its own options but the seldom used
#: ones; --help-all shows all.
USUAL_FIELDS = (
    "workspace", "pose", "law", "start", "move", "bandwidth", "damping", "overshoot", "preset", "remaining_error",
    "peak_effort", "peak_speed", "saturation", "measured", "estimator", "period", "latency", "draws",
)  # fmt: skip
SELDOM = (
    "pose_xyz", "tool", "every_cell", "decay", "threads", "cluster", "device", "shard", "starts", "metric", "batch",
    "core", "form", "table", "load_at", "noise", "method", "workers", "priority", "library", "gate", "bounds",
    "process_noise", "torque_noise", "measurement_noise",
)  # fmt: skip
SEVERAL = 16

CONTROLLER = (
    "design.toml, the folder of a report, or the file of a controller. The controller of a report is used as it was "
    "tested. A design.toml without one is designed first."
)
DESIGN = "design.toml, the folder of a report, or a robot as for `flexhinf design`."
FOLDER = "Folder of the report. An earlier report there is replaced."


# fmt: off
@dataclass(frozen=True, kw_only=True)
class PointOptions:
    """Options for the payload, and for a goal of a point of the robot."""

    payload: Text = option("", UNCERTAIN,
        "What the robot carries: 2kg, or a range 0..3kg. The lower end of a range is the nominal payload; 0..1..3kg "
        "states another one, and 0kg is an empty hand. @LINK names the link, :x,y,z its centre of mass there (m). "
        "Default: what the file states.", "2kg", "kg@link")
    pose_xyz: Text = option("", WAY,
        "Goal of a point of the robot in space, instead of --pose: 0.4,0,0.3 (m) or 400mm,0,300mm. The joint positions "
        "are computed. A point out of reach is refused; near a singular pose there is a note.",
        "0.4,0,0.3", "x,y,z")
    tool: Text = option("", WAY,
        "The point that goals in space are for: LINK:x,y,z in the link's frame (m). LINK is the name of the link's "
        "joint. It serves --pose-xyz, --workspace x=0.2:0.5, and waypoints with columns x, y, z. Default: the origin "
        "of the last link.",
        "hand:0,0,0.1", "link:x,y,z")


@dataclass(frozen=True, kw_only=True)
class VerboseOptions:
    """The option of commands that end with one screen."""

    verbose: bool = option(False, WRITTEN,
        "Print all tables and notes. The page has them anyway.")


@dataclass(frozen=True, kw_only=True)
class ThreadOptions:
    """The option of commands that use all processors."""

    threads: Threads | None = option(None, ADVANCED,
        "Threads and processes in all. No number depends on them.", "4", default="as many as processors")


@dataclass(frozen=True, kw_only=True)
class ElasticOptions:
    """The option that goes with a robot whose links another file states."""

    elastic: Text = option("", ROBOT,
        "With a URDF or MJCF: the robot file with spring and motor of each joint.")


@dataclass(frozen=True, kw_only=True)
class RequiredOptions:
    """The option for what every run of a campaign must keep."""

    require: list[Text] = option([], LOOP,
        "What a run must keep to count as a success. Repeat the option for more. Default: the run settles and keeps "
        "the limits of the design.", "overshoot_percent<=5", "metric<=x")


@dataclass(frozen=True, kw_only=True)
class RobotOptions(ElasticOptions, PointOptions):
    """Options of commands that take a robot or a design file, whose values other options replace."""

    robot: Text = argument(
        "A robot file (arm.toml), a URDF, an MJCF file (arm.xml), a name that `flexhinf robots` lists, or a design "
        "file (design.toml). Options win over a design file.", "ROBOT")


@dataclass(frozen=True, kw_only=True)
class DesignOptions(RobotOptions, VerboseOptions, ThreadOptions):
    """Options of ``flexhinf design``."""

    out: Path = option(Path("flexhinf-design"), WRITTEN, FOLDER)
    advice: Flag = option(True, SEARCH,
        "Whether changes are tried where a design for a workspace misses a requirement: slower moves, a shorter "
        "period, a limit with room. They take about as much CPU time again. The cheapest that meets all is named.")


@dataclass(frozen=True, kw_only=True)
class CompareOptions(RobotOptions, VerboseOptions, ThreadOptions):
    """Options of ``flexhinf compare``."""

    out: Path = option(Path("flexhinf-compare"), WRITTEN, FOLDER)
    laws: Text = option("", COMPARED,
        f"Names of laws between commas: pd,pid. They are {', '.join(LAWS)}. The default is "
        f"{', '.join(name for name, kind in LAWS.items() if kind.usual)}, of those that serve the task and the drives. "
        f"{NL_HINF} serves --pose alone.", "pd,pid")
    gains: Path | None = option(None, COMPARED,
        "A TOML file with numbers of laws, which are then not tuned. Its tables are named as laws are, and have "
        "bandwidth, damping and other numbers, or kp, kd and ki for each joint.", "gains.toml", unit="path")
    same_sensors: bool = option(False, COMPARED,
        "Every law measures what the design measures. Without this option each law has the sensors that its proponents "
        "would choose, such as an encoder on the motor for a PD.")


@dataclass(frozen=True, kw_only=True)
class CertifyOptions(RobotOptions, VerboseOptions, ThreadOptions):
    """Options of ``flexhinf certify``."""

    robot: Text = argument(
        "A robot file, a name that `flexhinf robots` lists, or a design file (design.toml). Options win over a design "
        "file.", "ROBOT", default="")
    out: Path = option(Path("flexhinf-certificate"), WRITTEN, FOLDER)
    check: Path | None = option(None, PROVED,
        "Check this certificate with the independent checker: the file, or the folder of --out.", unit="path")
    every_cell: bool = option(False, PROVED,
        "With --check: prove every cell in rationals and balls too, not a sample of them. It takes minutes for degree "
        "2, and hours for degree 6.")
    degree: Whole | None = option(None, PROVED,
        "Degree of V whose certificate is written.", "4", default="the design's")
    decay: Real = option(0.0, PROVED,
        "Rate of decay that is proved too, for disturbances that persist.", "0.1", "1/s")
    observer: Positive | None = option(None, PROVED,
        "Prove output feedback too, with an output-injection observer of this bandwidth.", "10", "1/s",
        default="the true state is fed back")
    tolerances: bool = option(False, PROVED,
        "Prove the step for every robot within the tolerances, instead of a region of the nominal robot.")


@dataclass(frozen=True, kw_only=True)
class BatchOptions(ElasticOptions, RequiredOptions, CampaignOptions, ThreadOptions):
    """Options that a campaign and a comparison of two campaigns share."""

    tolerance: list[Text] = option([], UNCERTAIN,
        "Another tolerance of a parameter: stiffness=15% or mass=0.9..1.2. That of friction means dry friction too. "
        "Repeat the option for more.",
        "stiffness=15%", "name=x")
    workers: Whole = option(0, RUN, "Worker processes; 0: this process alone, with `--threads`.", "4")
    cluster: Text = option("", RUN, "Address of a Dask scheduler, whose workers run the batches.", unit="tcp://…")
    device: Annotated[Literal["cpu", "gpu"], CHOICE] = option("cpu", RUN,
        "Where runs are made: gpu is NVIDIA's, of this machine or of the workers that have one. No number depends on "
        "it.", "gpu")
    shard: Text = option("", RUN, "Every n-th batch only, for job i of n. Then `merge`.", "1/4", "i/n")


@dataclass(frozen=True, kw_only=True)
class RunCampaignOptions(BatchOptions):
    """Options of ``flexhinf campaign``."""

    design: Text = argument(
        f"{DESIGN} The controller of a report is used as it was tested. Without one it is designed first.", "DESIGN")
    out: Path = option(Path("flexhinf-campaign"), WRITTEN, "Folder of the campaign. The same command continues there.")
    worst_case: bool = option(False, SEARCH,
        "Also search the tolerances for the worst robot, and compare it with the worst sample.")
    metric: list[Text] = option([], SEARCH,
        "Metric that --worst-case makes as bad as it can; damping is that of the linear loop, gain searches the worst "
        "disturbance. Repeat the option for more. Default: all that a requirement limits, and gain.", "gain")
    starts: Whole = option(8, SEARCH,
        "Searches of --worst-case for each metric. With more of them more robots run at once.", "8")


@dataclass(frozen=True, kw_only=True)
class CompareCampaignsOptions(BatchOptions):
    """Options of ``flexhinf campaign compare``."""

    first: Text = argument(DESIGN)
    second: Text = argument(DESIGN)
    out: Path = option(Path("flexhinf-pair"), WRITTEN, "Folder of the comparison. The same command continues there.")


@dataclass(frozen=True, kw_only=True)
class MergeOptions(RequiredOptions):
    """Options of ``flexhinf campaign merge``."""

    folder: Path = argument("The folder of a campaign.", "DIR")
    others: list[Path] = argument("Folders with other shards of the same campaign.", "[DIR…]", default=())


@dataclass(frozen=True, kw_only=True)
class ReplayOptions:
    """Options of ``flexhinf campaign replay``."""

    folder: Path = argument("The folder of a campaign.", "DIR")
    sample: Whole | None = option(None, RUN, "Number of the sample in the table.", "123")
    worst_case: Text = option("", RUN,
        "Instead of a sample: the robot that --worst-case found for this metric.", unit="metric")
    out: Path | None = option(None, WRITTEN, "Write all signals to run.csv or run.nc.", unit="path")


#: Of what leaves for a machine.
LIMITED = (
    "Whether a controller is refused that has an input without limits: no effort_limit in the robot file, and no "
    "--saturation at the design.")


@dataclass(frozen=True, kw_only=True)
class MachineOptions:
    """Options of commands by which a controller leaves for a machine."""

    accept_estimates: bool = option(False, TARGET,
        "Export a design although numbers of its robot are estimates and were not measured, such as the stiffness of "
        "a joint. Without this option it is refused.")
    accept_unmet: bool = option(False, TARGET,
        "Export a design although it misses requirements of its own. Without this option it is refused.")


@dataclass(frozen=True, kw_only=True)
class ExportCOptions(MachineOptions):
    """Options of ``flexhinf export c``."""

    source: Text = argument(CONTROLLER, "DESIGN")
    out: Path | None = option(None, WRITTEN, "A new or empty folder.", unit="path", default="DESIGN-c")
    name: Text = option("", WRITTEN, "A C identifier: name of the files, and beginning of all names.", "arm")
    real: Annotated[Literal["double", "float"], CHOICE] = option("double", TARGET,
        "Type of all numbers: double or float.", "float")
    period: Text = option("", TARGET,
        "Period of your firmware's loop. It has to be that of the design.", "1ms", "s")
    flash: Text = option("", TARGET,
        "Room for code and constants, such as 32kB. Code that needs more is refused. It is counted for a Cortex-M4F "
        "where arm-none-eabi-gcc is installed; without it only constants are, and a note says so.", "32kB")
    ram: Text = option("", TARGET, "Room for the state, such as 8kB. A state that needs more is refused.", "8kB")
    limits: bool = option(True, TARGET, LIMITED)
    narrower: Number | None = option(None, TARGET,
        "Narrower limit of all inputs, in their unit; the test vector has it.", "12")
    check_measurements: bool = option(True, TARGET,
        "Whether a measurement counts as missing, and is counted, that is beyond what the joint's range, its speed and "
        "the largest input allow. The speed is twice its speed_limit in the robot file or the design's --peak-speed; "
        "else it follows of voltage and back-EMF. Where a sensor has no limit, none is checked, and a note says so. "
        "Without it, only silent sensors, a wrong period and steps that fail stop the robot.")
    feedforward: bool = option(False, WRITTEN,
        "Export commands along a streamed path instead, without feedback: DESIGN is then a robot, by name or file.")
    path: Text = option("", WRITTEN,
        "Waypoints (CSV) of the path whose commands rows.csv gets, with --feedforward; by default an example.",
        "path.csv", "path")
    smoothing: Text = option("", TARGET,
        "Time between the knots of the spline that smooths a path, with --feedforward: five periods by default.",
        "20ms", "s")
    shaper: bool = option(False, TARGET,
        "Shape the path first, with --feedforward: where stiffness or load is uncertain, less vibration is left.")
    force: bool = option(False, WRITTEN, "Write into a folder that is not empty.")


@dataclass(frozen=True, kw_only=True)
class ExportFmuOptions(MachineOptions):
    """Options of ``flexhinf export fmu``."""

    source: Text = argument(CONTROLLER, "DESIGN")
    out: Path | None = option(None, WRITTEN, "The file that is written.", unit="path", default="DESIGN.fmu")
    name: Text = option("", WRITTEN, "A C identifier: the model's name.", "arm")
    fmi: Annotated[Literal["2.0", "3.0"], CHOICE] = option("2.0", TARGET,
        "Version of FMI: 2.0, which most programs read, or 3.0.", "3.0")
    limits: bool = option(True, TARGET, LIMITED)
    plant: bool = option(False, WRITTEN,
        "Export the elastic robot instead of the controller, as the design is judged by it.")


@dataclass(frozen=True, kw_only=True)
class ExportFileOptions:
    """Options of ``flexhinf export web``, and of exports that other packages add."""

    source: Text = argument(
        "design.toml or the folder of a report, whose controller is taken as it was judged; a design.toml without one "
        "is designed first.", "DESIGN")
    out: Path | None = option(None, WRITTEN, "What is written, a new file.", unit="path",
        default="DESIGN with the ending of the export")
    force: bool = option(False, WRITTEN, "Replace a file that is there.")


@dataclass(frozen=True, kw_only=True)
class ExportMjcfOptions(ElasticOptions):
    """Options of ``flexhinf export mjcf``."""

    source: Text = argument(
        "A robot file (arm.toml), a URDF, an MJCF file, a name that `flexhinf robots` lists, or a design, whose robot "
        "is taken.", "ROBOT")
    out: Path | None = option(None, WRITTEN, "The file that is written.", unit="path", default="NAME.xml")
    payload: Text = option("", ROBOT, "What the robot carries, as for `flexhinf design`: 2kg.", "2kg", "kg@link")
    force: bool = option(False, WRITTEN, "Replace a file that is there.")


@dataclass(frozen=True, kw_only=True)
class CompileOptions(MachineOptions):
    """Options of ``flexhinf compile``."""

    source: Text = argument(CONTROLLER, "DESIGN")
    out: Path | None = option(None, WRITTEN, "The file that is written.", unit="path", default="DESIGN.so")
    processor: Annotated[Literal["portable", "any", "native"], CHOICE] = option("portable", TARGET,
        "Processors that can run it: portable (PCs since about 2015), any (older ones too, half as fast), or "
        "native (like this one). Others refuse it.", "native")


@dataclass(frozen=True, kw_only=True)
class RunDesignOptions(PointOptions, VerboseOptions):
    """Options of ``flexhinf run``."""

    source: Text = argument(
        "design.toml or the folder of a report, whose controller is used as it was tested. A design.toml without one "
        "is designed first.", "DESIGN")
    mujoco: bool = option(False, RUN, "Drive the elastic robot in MuJoCo (needs flexhinf[mujoco]).")
    ros: bool = option(False, RUN,
        "Be a ROS 2 node whose robot in MuJoCo follows trajectories until Ctrl-C (needs rclpy).")
    library: Path | None = option(None, RUN,
        "Step this shared library of `flexhinf compile` instead of the controller in Python.", unit="path")
    perturb: list[Text] = option([], UNCERTAIN,
        "Another number in the robot that is driven: stiffness=-20%, friction_elbow=0.4. Repeat the option for more.",
        "stiffness=-20%", "name=value")
    load: Number | None = option(None, UNCERTAIN, "Torque on every link from --load-at on.", "0.5",
        "N·m or N", default="none")
    load_at: Seconds | None = option(None, UNCERTAIN, "Time at which the load begins.", "1s", "s",
        default="in the middle")
    noise: bool = option(True, UNCERTAIN, "Whether measurements have noise.")
    duration: Duration | None = option(None, RUN, "Length of the run.", "3s", "s",
        zero="the default", default="that of the design file, or 5 s; of a move its time and half of it again")
    realtime: bool = option(True, RUN,
        "Whether samples wait for the clock. Else they follow each other as fast as possible.")
    priority: Whole | None = option(None, RUN, "Priority of SCHED_FIFO, 1 to 99, where the system permits it.", "80",
        default="none")
    core: Whole | None = option(None, RUN, "Processor core that the loop is kept on.", "1", default="any")
    view: bool = option(False, WRITTEN, "Show the robot in MuJoCo's viewer during the run.")
    out: Path | None = option(None, WRITTEN,
        "Write a report into this folder: a page, its numbers, and the log as run.csv.", "flexhinf-run", "path",
        default="none")
    log: list[Path] = option([], WRITTEN,
        "Write all signals to a file: .csv or .parquet (PlotJuggler), .mcap (Foxglove). Repeat the option for more.",
        "run.csv", "path")
    record: list[Path] = option([], WRITTEN,
        "Write a film of links and motors: .mp4 or .gif. Repeat the option for more.", "arm.gif", "path")


@dataclass(frozen=True, kw_only=True)
class LogOptions(ElasticOptions):
    """Options of the commands that read a log."""

    log: Path = argument(
        "A log: .csv (a header, rows of numbers), .parquet, or .mcap (JSON, ROS 2).", "LOG")
    robot: Text = option("", ROBOT,
        "A robot file (arm.toml), a URDF, an MJCF file, a name that `flexhinf robots` lists, or a design. A design "
        "also states the sensors and noise levels of the filter.", "arm.toml", "ROBOT")
    payload: Text = option("", ROBOT, "What the robot carries, as for `flexhinf design`: 2kg.", "2kg", "kg@link")
    column: list[Text] = option([], LOGGED,
        "The column of a signal that has another name in the log: motor_position=pos. Add its unit, "
        "\"motor_position=pos [deg]\", or a factor to the SI unit, \"motor_position=counts [0.00153]\". "
        "link_position=q# are q1, q2, … of all joints. state.link_position is a true state, with which errors are "
        "compared. Repeat the option for more.",
        "motor_position=pos", "signal=column")
    time: Text = option("", LOGGED,
        "The column of times, if it is not called time, t, timestamp or stamp, or if its name has no unit: "
        "\"stamp [ms]\".", "stamp", "column")
    hold_inputs: bool = option(False, LOGGED, "An input acts until the next one, and rows may be without it.")
    latency: Whole | None = option(None, LOGGED,
        "Samples from the row of an input to the row from which on it acts. It is 1 where a controller logs what it "
        "sends and it acts a sample later, as in logs of `flexhinf run`.", "1", "samples",
        default="that of the design, or 0")
    sensor_delay: list[Text] = option([], LOGGED,
        "Samples by which a sensor is late: motor_position=1. Its values are moved back in the log. Repeat the option "
        "for more.", "motor_position=1", "signal=samples")
    missing: list[Number] = option([], LOGGED,
        "A value that stands for a missing one, in the unit of the file: -9999. Repeat the option for more.", "-9999",
        "number")
    unwrap: list[Text] = option([], LOGGED,
        "A sensor that begins anew after a turn, or when its counter is full: it goes on counting. `time` is the "
        "column of times. Repeat the option for more.", "motor_position", "signal")
    repeated: list[Text] = option([], LOGGED,
        "A sensor that is slower than the rows, and repeats its value: repeated ones count as missing. Repeat the "
        "option for more.", "link_position", "signal")


@dataclass(frozen=True, kw_only=True)
class CheckOptions(LogOptions):
    """Options of ``flexhinf check``."""

    model: bool = option(True, RUN,
        "Whether signals that are late or of the other sign are looked for by the robot's model, in seconds.")
    out: Path | None = option(None, WRITTEN,
        "Write a report into this folder: a page and its numbers.", "flexhinf-check", "path", default="none")


def drive_name(value: object) -> object:
    """The name of a drive, in small letters. Raises `InvalidInput` for one that is not known."""
    name = choice(value)
    one_of("The motors are driven in an unknown way.", name, DRIVES, "'position'")
    return name


DriveName = Annotated[str, read_by(drive_name), Allowed(", ".join(DRIVES))]


@dataclass(frozen=True, kw_only=True)
class InitOptions:
    """Options of ``flexhinf init``."""

    source: Text = argument("A URDF (.urdf) or an MJCF file (.xml); none with --joints.", "[FILE]", default="")
    move: list[Text] = option([], ROBOT,
        "A joint that is to move; all others are locked. Repeat the option for more.", "shoulder", "name",
        default="all with a motor that follow no other one")
    joints: Whole = option(0, ROBOT, "A template of so many joints in a vertical plane, instead of a file.", "3")
    gear: list[Text] = option([], ROBOT,
        "Published gear of a joint, by its name in `flexhinf robots`, or of all that turn: CSG-25-100. Repeat the "
        "option for more.", "shoulder=CSG-25-100", "joint=name", default="those that the file names")
    drive: DriveName | None = option(None, ROBOT,
        "What the motors take; current or voltage of a template, or where all are <dcmotor>.", "position",
        default="voltage where each joint has a <dcmotor> that takes it, else torque")
    out: Path | None = option(None, WRITTEN, "The robot file to write.", "arm.toml", "path",
        default="the name of the file with .toml, here")
    force: bool = option(False, WRITTEN, "Replace a file of that name.")


@dataclass(frozen=True, kw_only=True)
class EstimateOptions(LogOptions):
    """Options of ``flexhinf estimate``."""

    period: Period | None = option(None, ADVANCED,
        "Longest prediction in one piece: 0.001 (s) or 1ms. --process-noise and --torque-noise are per period.",
        "1ms", "s", default="that of the design, or the median time between rows")
    process_noise: NotNegative | None = option(None, ADVANCED,
        "q of R^v = q I, the variance added to every state per period.", "1e-10",
        default="that of the design, or none")
    torque_noise: NotNegative | None = option(None, ADVANCED,
        "Variance added to the velocities alone per period, where unknown torques act.", "1e-7",
        default="that of the design, or of torques of 1 % of the input")
    measurement_noise: Variances | None = option(None, ADVANCED,
        "Noise of the sensors, rms with a unit: 0.1mrad, or one per name of --measured, or per measured signal: "
        "0.1mrad,0.5Nm. A number without a unit is the variance of an angle, R^n: 1e-8 for 0.1mrad.", "0.1mrad", "rad²",
        default="that of the design, or from differences of neighbouring rows")
    filter: Annotated[Literal["unscented", "extended"], CHOICE] = option("unscented", SENSORS,
        "The Kalman filter: unscented or extended.", "extended")
    form: Annotated[Literal["square_root", "covariance"], CHOICE] = option("square_root", ADVANCED,
        "Form of the filter: square_root or covariance.", "covariance")
    gate: Probability | None = option(None, ADVANCED,
        "Share of good measurements that are used. Less likely ones are skipped as outliers, and counted.", "0.999",
        default="none: all are used")
    bounds: list[Text] = option([], ADVANCED,
        "Bounds of a state: link_position=-90deg..90deg, link_velocity_elbow=-2..2. Repeat the option for more.",
        "link_position=-90deg..90deg", "state=low..high")
    smooth: bool = option(False, WRITTEN,
        "Write estimates from all samples, before and after, too: columns `smoothed` (Rauch, Tung and Striebel).")
    table: Annotated[Literal["csv", "parquet"], CHOICE] = option("csv", WRITTEN,
        "File format of the estimates: csv or parquet.", "parquet")
    out: Path = option(Path("flexhinf-estimate"), WRITTEN, FOLDER)


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions(LogOptions, ThreadOptions):
    """Options of ``flexhinf identify``."""

    parameters: Text = option("", ROBOT,
        "What to identify: stiffness for all joints, stiffness_elbow for one. The names are those of the robot's file.",
        "stiffness,friction", "LIST", default="numbers that have a tolerance in the robot's file")
    process_noise: NotNegative | None = option(None, ADVANCED,
        "q of R^v = q I, the variance added to every state per row. It then is not searched.", "1e-10",
        default="searched: level of each disturbance")
    torque_noise: NotNegative | None = option(None, ADVANCED,
        "Variance added to the velocities alone per row, where unknown torques act. It then is not searched.", "1e-7",
        default="searched: level of each disturbance")
    disturbance: Positive = option(1.0, ADVANCED,
        "Largest disturbances with which the model fits, in per cent of the input. Larger ones absorb what it lacks.",
        "5", "%")
    measurement_noise: Variances | None = option(None, ADVANCED,
        "Noise of the sensors, as for `flexhinf estimate`: 0.1mrad. It then is not searched.", "0.1mrad", "rad²",
        default="searched, at least that of the smallest step in the log")
    quantisation: Quanta | None = option(None, ADVANCED,
        "Resolution of the sensors, as for `flexhinf design`: 0.01deg. Noise is at least that of a step.", "1e-4",
        "rad, m, …", default="the smallest step in the log")
    simulate: bool = option(True, RUN,
        "Whether a simulation with the inputs of the log is fitted too, as a second opinion.")
    motion: Seconds = option(10.0, WRITTEN,
        "Longest duration of a motion that is proposed where the log does not determine a parameter.", "5", "s")
    seed: Whole = option(0, ADVANCED, "Seed of the motions that are tried.", "1")
    out: Path = option(Path("flexhinf-identify"), WRITTEN, FOLDER)


@dataclass(frozen=True, kw_only=True)
class StudioOptions(ElasticOptions, ThreadOptions):
    """Options of ``flexhinf studio``."""

    robot: Text = argument(
        "A robot file, a URDF, an MJCF file, a name that `flexhinf robots` lists, or a design file. Default: the arm "
        "of the paper.", "ROBOT", default="")
    port: Whole = option(0, RUN, "Port at 127.0.0.1, 1 to 65535; 0: a free one, which is printed.", "8080")
    browser: bool = option(True, RUN, "Whether the page is opened in the browser.")


@dataclass(frozen=True, kw_only=True)
class PaperOptions(PaperSettings, ThreadOptions):
    """Options of ``flexhinf paper``."""

    out: Path = option(Path("flexhinf-paper"), WRITTEN, FOLDER)
# fmt: on
