"""PLAN: excitation maneuvers by Kriging, Sobol' indices and DIRECT."""

from excitation_planner.box import Box
from excitation_planner.design.criteria import Criterion, TrajectoryErrorNoise
from excitation_planner.design.evaluation import Evaluation
from excitation_planner.design.excitation import Design, Verdict, design_excitation
from excitation_planner.design.information import ManeuverSet, Prior, TrajectoryNoise
from excitation_planner.design.search import Search
from excitation_planner.design.study import Proposal, Study
from excitation_planner.indices.infill import Infill
from excitation_planner.indices.kriging import Kriging
from excitation_planner.indices.sensitivity import Sensitivity, sensitivity
from excitation_planner.indices.sobol import Indices, monte_carlo_indices, sobol_indices
from tricycle_core.errors import DesignError, InfeasibleManeuver
from tricycle_core.renamed import install

__all__ = [
    "Box",
    "Criterion",
    "Design",
    "DesignError",
    "Evaluation",
    "Indices",
    "InfeasibleManeuver",
    "Infill",
    "Kriging",
    "ManeuverSet",
    "Prior",
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

install()
