"""The package's public names and the files that they come from; read when a name is first used."""

from .kinds import (
    ESTIMATORS as ESTIMATORS,
    EstimatorKind as EstimatorKind,
    EstimatorTask as EstimatorTask,
    is_kalman as is_kalman,
    register as register,
)
from .modal import (
    MODAL as MODAL,
    estimator_name_at_any_pose as estimator_name_at_any_pose,
    fits_modal as fits_modal,
)
