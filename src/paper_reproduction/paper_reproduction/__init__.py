"""The paper's tables and figures, computed again: what `tricycle reproduce` shows."""

from paper_reproduction.comparison import Agreement, Comparison, Item
from paper_reproduction.first_stage import PaperBudget

__all__ = ["Agreement", "Comparison", "Item", "PaperBudget"]
