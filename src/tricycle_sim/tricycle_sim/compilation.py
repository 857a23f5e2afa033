"""How this package compiles its kernels: once, cached on disk, eight lanes wide.

The machine code is kept in `__pycache__` beside the sources or, where that is not writable, in
numba's folder of the user; `NUMBA_CACHE_DIR` names another place. Where nothing is writable every
process compiles for itself. Processes that start at the same time may compile twice, never break.
"""

import dis
import hashlib
import logging
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
from llvmlite import binding as llvm
from numba.core import event
from numba.core.runtime import rtsys

from tricycle_core import timing

_LOGGER = logging.getLogger(__name__)

# LLVM prefers vectors of 256 bits on processors that have 512: eight lanes then cost twice. The
# setting is process-wide and has to be made before numba compiles its first function.
if numba.config.CPU_NAME is None and numba.config.CPU_FEATURES is None:
    _FEATURES = llvm.get_host_cpu_features()
    if _FEATURES.get("avx512f"):
        numba.config.CPU_FEATURES = f"{_FEATURES.flatten()},-prefer-256-bit"

# Sums may be reordered and multiply-adds fused; NaN and infinity keep their meaning.
FASTMATH = {"reassoc", "contract", "arcp", "nsz", "afn"}


def sources() -> list[Path]:
    """Return the files that are compiled into each other, or whose numbers are."""
    folder = Path(__file__).parent
    vehicle = sorted(folder.glob("vehicle/*.py"))
    return [*vehicle, folder / "setpoints.py", Path(__file__), Path(timing.__file__)]


_FINGERPRINT = hashlib.sha256(b"".join(path.read_bytes() for path in sources())).hexdigest()


_OPTIONS: dict[str, Any] = {"fastmath": FASTMATH, "error_model": "numpy"}
# of what only compiled code calls: each would be compiled with all that it inlines
_NO_WRAPPERS = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@cache
def compilable(function: Callable[..., Any]) -> Any:
    """Return a function that is marked by `tricycle_sim.vehicle.laws.inlined` as numba takes it.

    Parameters
    ----------
    function : callable
        Python function; those that it calls may be marked too.
    """
    if numba.config.DISABLE_JIT:
        return function
    return numba.njit(
        _with(function, {}, function.__qualname__), forceinline=True, **_NO_WRAPPERS, **_OPTIONS
    )


@cache
def compilable_for_card(function: Callable[..., Any]) -> Any:
    """Return a function that is marked by `inlined` as numba takes it for a graphics card.

    Parameters
    ----------
    function : callable
        Python function, as in `compilable`.
    """
    from numba import cuda  # takes 0.3 s

    own = _with(function, {}, function.__qualname__, compilable_for_card)
    return cuda.jit(own, device=True)


def _with(
    function: Any,
    names: dict[str, Any],
    qualname: str,
    take: Callable[[Any], Any] = compilable,
) -> FunctionType:
    """Return a copy of a function with other globals, what it inlines as numba takes it."""
    scope = {**function.__globals__, **names}
    # not `co_names`: attributes are there too, and one may be called as the function itself
    loaded = {i.argval for i in dis.get_instructions(function) if i.opname == "LOAD_GLOBAL"}
    for name in loaded:
        if getattr(scope.get(name), "is_inlined", False):
            scope[name] = take(scope[name])
    copy = FunctionType(function.__code__, scope, function.__name__, function.__defaults__)
    copy.__qualname__, copy.__module__ = qualname, function.__module__
    return copy


def compiled(
    function: Callable[..., Any], variant: str = "", *, exact: bool = False, **names: Any
) -> Any:
    """Compile a function, cached on disk, that releases the interpreter while it runs.

    Parameters
    ----------
    function : callable
        Function at the top level of a module: numba keeps no closures over compiled functions on
        disk.
    variant : str
        Tells the code on disk apart where the function is compiled with several `names`.
    exact : bool
        Whether sums keep their order, and every operation its rounding.
    **names : object
        Values of global names of the function, instead of its module's.
    """
    original = function
    if names or any(
        getattr(function.__globals__.get(name), "is_inlined", False)
        for name in function.__code__.co_names
    ):
        qualname = f"{function.__name__}-{variant}" if names else function.__qualname__
        function = _with(function, names, qualname)
    if numba.config.DISABLE_JIT:  # coverage looks into the functions
        return function
    options = {"nogil": True, **_OPTIONS, **({"fastmath": False} if exact else {})}
    try:
        dispatcher = numba.njit(function, cache=True, **options)
    except RuntimeError:  # numba found no folder that it may write to
        _LOGGER.warning(
            "compiled code cannot be kept: set NUMBA_CACHE_DIR to a folder that can be written"
        )
        return numba.njit(function, **options)
    _stamp(dispatcher, original)
    dispatcher._cache.load_overload = partial(_load, dispatcher._cache)  # noqa: SLF001
    return dispatcher


def compiled_for_card(function: Callable[..., Any], variant: str, **names: Any) -> Any:
    """Compile a function for the graphics card, cached on disk.

    Parameters
    ----------
    function, variant, **names : object
        Arguments as in `compiled`.
    """
    from numba import cuda

    own = _with(function, names, f"{function.__name__}-{variant}", compilable_for_card)
    if numba.config.ENABLE_CUDASIM:  # runs it as Python
        return cuda.jit(own)
    try:
        dispatcher = cuda.jit(own, cache=True)
    except RuntimeError:  # as in `compiled`
        return cuda.jit(own)
    _stamp(dispatcher, function)
    return dispatcher


def _stamp(dispatcher: Any, function: Any) -> None:
    """Make the code on disk depend on all that is compiled into a function.

    Numba notices changes of the function's own file only; what it calls and the numbers that it
    imports are compiled in as well.
    """
    numbers = {
        name: function.__globals__[name]
        for name in function.__code__.co_names
        if isinstance(function.__globals__.get(name), int | float)
    }
    file = dispatcher._cache._cache_file  # noqa: SLF001 (numba has no public way)
    file._source_stamp = (file._source_stamp, _FINGERPRINT, repr(numbers))  # noqa: SLF001


def _load(cache: Any, signature: Any, target: Any) -> Any:
    """Load compiled code as numba does, but without all that numba needs for compiling only.

    That is all it knows of Python and NumPy, and SciPy: most of the time that a node takes to
    start. Where there is nothing to load, the compiler gets it ready itself.
    """
    rtsys.initialize(target)
    return cache._load_overload(signature, target)  # noqa: SLF001


class _Announcement(event.Listener):
    """Say once, through the logger, why the first start takes longer."""

    said = False

    def on_start(self, event: event.Event) -> None:
        function = event.data["dispatcher"].py_func
        if not self.said and function.__module__.startswith("tricycle_sim."):
            self.said = True
            # each command compiles what it needs and was not compiled before
            _LOGGER.info("compiling the vehicle model for this command: once, takes about 20 s")

    def on_end(self, event: event.Event) -> None:
        """Nothing to say."""


event.register("numba:compile", _Announcement())
