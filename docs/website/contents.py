"""Which public names and which examples stand together on the site."""

from __future__ import annotations

#: Title of a group of public names: its sentence and its names. Every public name is in one group.
NAMES: dict[str, tuple[str, tuple[str, ...]]] = {
    "Robots": (
        "Arms with elastic joints, from a file or from the catalogue.",
        ("Robot", "Parameter", "load_robot", "paper_arm", "catalogue"),
    ),
    "Designs": (
        "From a robot and a specification to a judged controller.",
        (
            "design",
            "Specification",
            "Design",
            "compare",
            "Comparison",
            "load_design",
        ),
    ),
    "Plants and problems": (
        "Models of any system, what is measured of it, and what a law is asked for.",
        (
            "Plant",
            "BlackBox",
            "Sensor",
            "Penalty",
            "GeneralisedPlant",
            "PolynomialPlant",
            "Gaussian",
            "Law",
            "Estimator",
        ),
    ),
    "Synthesis": (
        "Hamilton–Jacobi–Isaacs equations and their laws.",
        ("smallest_gamma", "solve_hji", "linear_law", "HJISolution", "load_solution", "ModalLaw"),
    ),
    "Proofs": (
        "Bounds that are proved on a region, and their files.",
        ("Certificate", "load_certificate"),
    ),
    "Estimation": (
        "Kalman filters and observers.",
        (
            "UnscentedKalmanFilter",
            "ExtendedKalmanFilter",
            "ModalFilter",
            "OutputInjectionObserver",
            "diagnose",
            "Diagnosis",
        ),
    ),
    "Closed loops": (
        "A controller, a true plant, and a run of both.",
        (
            "Controller",
            "load_controller",
            "Status",
            "Supervision",
            "Protection",
            "Start",
            "Stop",
            "Schedule",
            "Loop",
            "Trajectory",
        ),
    ),
    "References and moves": (
        "What a loop is told to follow.",
        (
            "Step",
            "Sine",
            "Constant",
            "Samples",
            "Quintic",
            "JerkLimited",
            "Spline",
            "Waypoints",
            "Moving",
            "Braked",
            "Feedforward",
            "Follower",
            "FollowGoal",
        ),
    ),
    "Campaigns": ("One controller on many robots.", ("run_campaign",)),
    "Logs and identification": (
        "A log through a filter, and the numbers of a robot from a log.",
        (
            "read_log",
            "Log",
            "examine",
            "LogFinding",
            "filter_log",
            "consistency",
            "identify",
            "Identification",
            "output_error",
            "OutputError",
            "excitation",
            "Excitation",
        ),
    ),
    "Export": (
        "A controller as C, as a shared library, as an FMU, in real time.",
        (
            "export_c",
            "export_fmu",
            "export_web",
            "compile_controller",
            "CompiledController",
            "load_compiled",
            "run_realtime",
            "run_ros",
        ),
    ),
    "Errors": (
        "Every error of the package has three parts: what is wrong, what was expected, what to try.",
        (
            "FlexhinfError",
            "InvalidInput",
            "InfeasibleGamma",
            "NotStabilisable",
            "NotDetectable",
            "NumericalFailure",
        ),
    ),
}

#: Folder of a group: title, sentence, and the examples in their order. What is in no group is in the last one.
EXAMPLES: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "arms": (
        "Arms with elastic joints",
        "From one joint to several: vibrations, a step, a move, a payload.",
        (
            "two_link_swing",
            "vibration_modes",
            "pd_against_hinf",
            "step_response",
            "payload_step",
            "sensor_choice",
            "latency",
            "motions",
            "moving_reference",
            "several_poses",
            "specified_design",
            "two_link_arm",
            "paper_figures",
        ),
    ),
    "regions": (
        "Regions, proofs and campaigns",
        "Where a law can be trusted, what can be proved, and how many arms of a series keep their limits.",
        ("region_of_validity", "certificate_region", "campaign_band"),
    ),
    "estimation": (
        "Estimation",
        "Kalman filters, and numbers of a robot from a log.",
        ("ukf_against_ekf", "nees", "identify_joint"),
    ),
    "textbook": (
        "Any nonlinear system",
        "Hamilton–Jacobi–Isaacs equations of systems that are no robots.",
        (
            "van_der_pol",
            "v_surface",
            "hji_scalar",
            "f8_aircraft",
            "gamma_tradeoff",
            "residual_order",
            "own_plant",
            "stirred_tank",
            "certified_reactor",
        ),
    ),
    "more": ("More", "Other programs.", ()),
}
