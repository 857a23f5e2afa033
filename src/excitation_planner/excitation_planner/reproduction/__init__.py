"""The paper's tables and figures, computed again: what `tricycle reproduce` shows."""

from excitation_planner.reproduction.comparison import Agreement, Comparison, Item
from excitation_planner.reproduction.first_stage import PaperBudget

__all__ = ["Agreement", "Comparison", "Item", "PaperBudget"]
