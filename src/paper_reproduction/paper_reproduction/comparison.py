"""Comparison of one table or figure of the paper with ours."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, TypeVar

import numpy as np

from tricycle_core.quantities import FloatArray

Data = TypeVar("Data")


class Agreement(StrEnum):
    """Relation of our number to the published one."""

    REPRODUCED = "reproduced"
    BETTER = "better than published"
    NOT_REPRODUCED = "not reproduced"
    IMPOSSIBLE = "published value cannot be right"
    PICTURE = "published as a picture only"


@dataclass(frozen=True)
class Comparison:
    """One published quantity and ours.

    Attributes
    ----------
    quantity : str
        Quantity that is compared.
    published, ours : float or str
        Published and reproduced value; a string is a statement.
    agreement : Agreement
        Agreement of both.
    """

    quantity: str
    published: float | str
    ours: float | str
    agreement: Agreement


@dataclass(frozen=True)
class Item(Generic[Data]):
    """A table or figure, reproduced.

    Attributes
    ----------
    name, title : str
        Short name (`table1`, `fig5`), and what it shows.
    comparisons : tuple of Comparison
        Published numbers beside ours.
    findings : tuple of str
        Results, in sentences with their numbers.
    data : object
        Content of the figure, described by its class.
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
    r2 : float
        Coefficient of determination.
    raae, rmae : float
        Mean and largest absolute error, divided by the output's standard deviation.
    mean, std : float
        Mean and standard deviation of the error, predicted minus true.
    output_mean, output_std : float
        Mean and standard deviation of the true output.
    """

    r2: float
    raae: float
    rmae: float
    mean: float
    std: float
    output_mean: float
    output_std: float


def error_statistics(predicted: FloatArray, true: FloatArray) -> ErrorStatistics:
    """Compare predicted and true outputs.

    Parameters
    ----------
    predicted, true : ndarray of float, shape (n,)
        Predicted and true outputs.
    """
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
