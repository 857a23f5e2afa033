"""PLAN: excitation maneuvers by Kriging, Sobol' indices and DIRECT. Loaded when first used."""

import lazy_loader

from tricycle_core.errors import DesignError, InfeasibleManeuver
from tricycle_core.renamed import install

__getattr__, __dir__, _lazy = lazy_loader.attach_stub(__name__, __file__)
__all__ = [*_lazy, "DesignError", "InfeasibleManeuver"]

install()
