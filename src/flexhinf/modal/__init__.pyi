"""The room's public names and the files that they come from; read when a name is first used."""

from .law import (
    ModalLaw as ModalLaw,
    modes as modes,
)
from .pair import (
    Pair as Pair,
    PairGains as PairGains,
    PairWeights as PairWeights,
    pair_gains as pair_gains,
)
from .stability import (
    ProvedRange as ProvedRange,
    proved_range as proved_range,
)
from .tolerance import (
    Tolerance as Tolerance,
    error_tolerance as error_tolerance,
    tolerated_error as tolerated_error,
)
