"""PLAN: excitation maneuvers by Kriging, Sobol' indices and DIRECT."""

from excitation_planner.box import Box
from excitation_planner.criteria import Criterion, TrajectoryErrorNoise
from excitation_planner.design import Design, Verdict, design_excitation
from excitation_planner.errors import DesignError, InfeasibleManeuver
from excitation_planner.evaluation import Evaluation
from excitation_planner.infill import Infill
from excitation_planner.information import ManeuverSet, Prior, TrajectoryNoise
from excitation_planner.kriging import Kriging
from excitation_planner.search import Search
from excitation_planner.sensitivity import Sensitivity, sensitivity
from excitation_planner.sobol_indices import Indices, monte_carlo_indices, sobol_indices
from excitation_planner.study import Proposal, Study

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
