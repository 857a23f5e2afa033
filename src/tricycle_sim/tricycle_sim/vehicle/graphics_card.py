"""The equations of motion on a graphics card: one of its threads drives one vehicle.

Compiled from the functions of `kernel`; only the loop over the steps is its own, because there all
vehicles of a group take a stage before any takes the next. Needs the extra `gpu` and a card by
NVIDIA; `CUDA_VISIBLE_DEVICES=""` hides it.
"""

import functools
import logging
import warnings
from collections.abc import Callable
from typing import Any

import numba
from numba import cuda, float64
from numpy.typing import NDArray

from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.compilation import compilable_for_card, compiled_for_card
from tricycle_sim.vehicle.constants import Vehicle
from tricycle_sim.vehicle.kernel import COMMAND, laws_of, slopes, variant_of, watch
from tricycle_sim.vehicle.layout import ALIVE, LANES, SLOPE, START, STATE, SUM
from tricycle_sim.vehicle.parts import ROWS, Structure, structure_of

logging.getLogger("numba.cuda").setLevel(logging.WARNING)  # it logs every allocation
# a few thousand samples do not fill a card, and are faster on it all the same
warnings.filterwarnings("ignore", message=".*under-utilization")

_THREADS = 64
"""Threads of a block of the card; a whole number of groups. Fewer or more do not pay, up to 128."""
_OWN_ROWS = ROWS * LANES
"""Rows of a thread's copy of its vehicle: a group of which it uses the first lane."""


def is_there() -> bool:
    """Return whether this process may use a graphics card."""
    return not numba.config.DISABLE_JIT and bool(cuda.is_available())


def advance_for(vehicle: Vehicle, *, own_commands: bool = False) -> Callable[..., None]:
    """Return `Functions.advance` of `kernel` as the graphics card runs it: arguments as there.

    The numbers are those of the processor's cores but for the rounding of their sums.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle; its wheels and laws are used.
    own_commands : bool
        As for `functions_for`.
    """
    kernel = _compile(structure_of(vehicle), own_commands)

    def advance(
        groups: FloatArray,
        table: FloatArray,
        steering_lag: FloatArray,
        drive: FloatArray,
        substeps: int,
        first_tick: int,
        rows: NDArray[Any],
        every: int,
        out: FloatArray,
    ) -> None:
        stream = cuda.stream()  # of its own: several threads keep the card busy
        there = [
            cuda.to_device(array, stream) for array in (groups, table, steering_lag, drive, rows)
        ]
        found = cuda.device_array(out.shape, out.dtype, stream=stream)
        blocks = -(-len(groups) * LANES // _THREADS)
        kernel[blocks, _THREADS, stream](*there[:4], substeps, first_tick, there[4], every, found)
        found.copy_to_host(out, stream)
        there[0].copy_to_host(groups, stream)
        stream.synchronize()

    return advance


@functools.lru_cache(maxsize=1)
def page_locked(blocks: int, size: int) -> FloatArray:
    """Return memory that the card writes to faster than to any other; kept until asked for others.

    Parameters
    ----------
    blocks, size : int
        Number of blocks and size of each: the shape of the array.
    """
    memory: FloatArray = cuda.pinned_array((blocks, size))
    return memory


@functools.cache
def _compile(structure: Structure, own_commands: bool) -> Any:
    laws = laws_of(structure, own_commands, compilable_for_card)
    return compiled_for_card(_advance_each, variant_of(structure, own_commands), laws=laws)


laws: Any = None  # a template, as those of `kernel`


def _advance_each(  # type: ignore[no-untyped-def]
    groups, table, steering_lag, drive, substeps, first_tick, rows, every, out
) -> None:
    vehicle = cuda.grid(1)
    lane = vehicle % LANES
    if vehicle >= groups.shape[0] * LANES:
        return
    group = groups[vehicle // LANES]
    g = cuda.local.array(_OWN_ROWS, float64)  # most of it becomes registers
    for row in range(ROWS):
        g[row * LANES] = group[row * LANES + lane]
    ticks = drive.shape[0] - 1
    h = TICK / substeps
    first_row, first, step = 0, 0, 1  # where its columns are in the table
    if laws.own_commands:
        first_row = vehicle // LANES * (table.shape[0] // groups.shape[0])
        first, step = lane, LANES
    for k in range(ticks + 1):
        speed_mode, brake = drive[k, COMMAND.speed_mode], drive[k, COMMAND.brake]
        for s in range(substeps):
            for stage in range(4):  # of the classical Runge-Kutta method
                commands = table[first_row + 2 * (k * substeps + s) + (stage + 1) // 2]
                demand = drive[k, COMMAND.demand]
                if laws.own_commands:
                    demand += commands[8 * LANES + lane]
                steering = (
                    commands[first],
                    commands[first + step],
                    commands[first + 2 * step],
                    commands[first + 3 * step],
                    commands[first + 4 * step],
                    commands[first + 5 * step],
                    commands[first + 6 * step],
                    commands[first + 7 * step],
                )
                slopes(laws, g, 0, steering, speed_mode, demand, brake)
                if stage == 0:
                    if s == 0:
                        watch(laws, g, 0, float(first_tick + k), steering_lag[k])
                        if g[ALIVE * LANES] == 0.0:  # bring it to rest
                            for j in range(STATE.u, laws.states):
                                g[j * LANES] = 0.0
                            for j in range(laws.states):
                                g[(SLOPE + j) * LANES] = 0.0
                        if k % every == 0:
                            for m in range(rows.shape[0]):
                                out[m, vehicle, k // every] = g[rows[m] * LANES]
                    if k == ticks:
                        break
                    for j in range(laws.states):
                        g[(START + j) * LANES] = g[j * LANES]
                        g[(SUM + j) * LANES] = g[j * LANES]
                weight = h / 6.0 if stage == 0 or stage == 3 else h / 3.0
                ahead = h if stage == 2 else h / 2.0
                for j in range(laws.states):
                    slope = g[(SLOPE + j) * LANES]
                    g[(SUM + j) * LANES] += weight * slope
                    g[j * LANES] = g[(START + j) * LANES] + ahead * slope
            if k == ticks:
                break
            # one that has rolled over stays where the step began
            source = SUM if g[ALIVE * LANES] == 1.0 else START
            for j in range(laws.states):
                g[j * LANES] = g[(source + j) * LANES]
    for row in range(ROWS):
        group[row * LANES + lane] = g[row * LANES]
