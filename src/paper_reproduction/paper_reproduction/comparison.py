"""One table or figure of the paper beside ours."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, TypeVar

import numpy as np

from tricycle_core.quantities import FloatArray

Data = TypeVar("Data")


class Agreement(StrEnum):
    """How our number stands to the published one."""

    REPRODUCED = "reproduced"
    BETTER = "better than published"
    NOT_REPRODUCED = "not reproduced"
    IMPOSSIBLE = "the published value cannot be right"
    PICTURE = "published as a picture only"


@dataclass(frozen=True)
class Comparison:
    """One published quantity and ours; a published string is a statement, not a number."""

    quantity: str
    published: float | str
    ours: float | str
    agreement: Agreement


@dataclass(frozen=True)
class Item(Generic[Data]):
    """A table or figure, reproduced.

    Attributes
    ----------
    comparisons
        Published numbers beside ours.
    findings
        What we find, in sentences with their numbers.
    data
        What the figure shows; its class says how.
    """

    name: str
    title: str
    comparisons: tuple[Comparison, ...]
    findings: tuple[str, ...]
    data: Data

    @property
    def verdict(self) -> str:
        """How many of the published quantities agree, in words."""
        found = [comparison.agreement for comparison in self.comparisons]
        return ", ".join(
            f"{found.count(agreement)} {agreement}" for agreement in Agreement if agreement in found
        )


@dataclass(frozen=True)
class ErrorStatistics:
    """Errors of a metamodel at points it has not seen, in the unit of the output.

    Attributes
    ----------
    r2
        Coefficient of determination.
    raae, rmae
        Mean and largest absolute error, divided by the output's standard deviation.
    mean, std
        Of the error, predicted minus true.
    output_mean, output_std
        Of the true output.
    """

    r2: float
    raae: float
    rmae: float
    mean: float
    std: float
    output_mean: float
    output_std: float


def error_statistics(predicted: FloatArray, true: FloatArray) -> ErrorStatistics:
    """Compare predicted and true outputs (n,)."""
    error, std = predicted - true, float(true.std())
    return ErrorStatistics(
        r2=float(1 - np.mean(error**2) / std**2),
        raae=float(np.abs(error).mean()) / std,
        rmae=float(np.abs(error).max()) / std,
        mean=float(error.mean()),
        std=float(error.std()),
        output_mean=float(true.mean()),
        output_std=std,
    )
