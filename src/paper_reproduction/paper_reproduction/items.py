"""Every table and figure by its name."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from typing import Any

from paper_reproduction import math_model
from paper_reproduction.comparison import Item
from paper_reproduction.first_stage import OurBudget, PaperBudget
from paper_reproduction.tricycle import Tricycle
from tricycle_core.quantities import Progress


class Reproduction:
    """The paper's tables and figures; what several of them need is computed once.

    Parameters
    ----------
    executor : Executor
        Where the long computations run.
    ours : OurBudget, optional
        Budget of our own method.
    budget : PaperBudget, optional
        Budget of the paper's method, which is then followed as well; None: it is left out.
    """

    def __init__(
        self,
        executor: Executor,
        *,
        ours: OurBudget | None = None,
        budget: PaperBudget | None = None,
    ) -> None:
        ours = ours or OurBudget()
        tricycle = Tricycle(executor, ours=ours, budget=budget)
        self._items: dict[str, Callable[[Progress], Item[Any]]] = {
            "table1": lambda _: math_model.table_1(),
            "fig5": lambda _: math_model.figure_5(ours, budget),
            "fig6": lambda _: math_model.figure_6(budget),
            "fig8": lambda report: math_model.figure_8_or_9("p1", ours, budget, executor, report),
            "fig9": lambda report: math_model.figure_8_or_9("p3", ours, budget, executor, report),
            "screening": tricycle.screening,
            "fig13": tricycle.figure_13,
            "fig14": lambda report: tricycle.bars("circle", report),
            "fig15": lambda report: tricycle.bars("double_lane_change", report),
            "fig16": tricycle.figure_16,
            "fig17": lambda report: tricycle.figure_17_or_18("circle", report),
            "fig18": lambda report: tricycle.figure_17_or_18("double_lane_change", report),
        }

    def item(self, name: str, progress: Progress) -> Item[Any]:
        """Return the table or figure of that name (one of `published.ITEMS`).

        Parameters
        ----------
        name : str
            Name of the table or figure.
        progress : callable
            Called with the amount of work done and of all.
        """
        return self._items[name](progress)
