"""How this package compiles its kernels: once, cached on disk, eight lanes wide.

The machine code is kept in `__pycache__` beside the sources or, where that is not writable, in
numba's folder of the user; `NUMBA_CACHE_DIR` names another place. Where nothing is writable every
process compiles for itself.
"""

import logging
from collections.abc import Callable
from typing import Any

import numba
from llvmlite import binding as llvm  # type: ignore[import-untyped]

_LOGGER = logging.getLogger(__name__)

# LLVM prefers vectors of 256 bits on processors that have 512: eight lanes then cost twice. The
# setting is process-wide and has to be made before numba compiles its first function.
if numba.config.CPU_NAME is None and numba.config.CPU_FEATURES is None:
    _FEATURES = llvm.get_host_cpu_features()
    if _FEATURES.get("avx512f"):
        numba.config.CPU_FEATURES = f"{_FEATURES.flatten()},-prefer-256-bit"

# Sums may be reordered and multiply-adds fused; NaN and infinity keep their meaning.
FASTMATH = {"reassoc", "contract", "arcp", "nsz", "afn"}


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function into its callers."""
    return numba.njit(function, forceinline=True, fastmath=FASTMATH, error_model="numpy")


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function, cached on disk, that releases the interpreter while it runs."""
    options = {"nogil": True, "fastmath": FASTMATH, "error_model": "numpy"}
    try:
        return numba.njit(function, cache=True, **options)
    except RuntimeError:  # numba found no folder that it may write to
        _LOGGER.warning(
            "compiled code cannot be kept: set NUMBA_CACHE_DIR to a folder that can be written"
        )
        return numba.njit(function, **options)
