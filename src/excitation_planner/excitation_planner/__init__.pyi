import tricycle_core.errors as _errors

from .box import Box
from .design.criteria import Criterion
from .design.excitation import Design, Verdict, design_excitation
from .design.information import ManeuverSet
from .design.noise import MeasurementNoise, TrajectoryErrorNoise, TrajectoryNoise
from .design.prior import BoxPrior
from .design.problem import Evaluation, Search
from .design.study import Proposal, Study
from .indices.infill import Infill
from .indices.kriging import Kriging
from .indices.sensitivity import Sensitivity, sensitivity
from .indices.sobol import Indices, monte_carlo_indices, sobol_indices

DesignError = _errors.DesignError
InfeasibleManeuver = _errors.InfeasibleManeuver

__all__ = [
    "Box",
    "BoxPrior",
    "Criterion",
    "Design",
    "DesignError",
    "Evaluation",
    "Indices",
    "InfeasibleManeuver",
    "Infill",
    "Kriging",
    "ManeuverSet",
    "MeasurementNoise",
    "Proposal",
    "Search",
    "Sensitivity",
    "Study",
    "TrajectoryErrorNoise",
    "TrajectoryNoise",
    "Verdict",
    "design_excitation",
    "monte_carlo_indices",
    "sensitivity",
    "sobol_indices",
]
