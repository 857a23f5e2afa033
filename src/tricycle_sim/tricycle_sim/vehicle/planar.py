"""Paths of many vehicles under one command history, block by block: what the planner calls.

The letters of shapes: `n` samples (vehicles), `b` of a block, `k` unknown parameters, `t` time
points. Many samples go to the graphics card, where there is one that was faster in a trial: the
last digits of their numbers are others than those of the processor's cores.
"""

import functools
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tricycle_core.cores import usable_cores
from tricycle_core.quantities import FloatArray, Progress
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle.batch import CommandedBatch, Run, check_parameters, run_blocks
from tricycle_sim.vehicle.constants import Vehicle
from tricycle_sim.vehicle.feasibility import Feasibility
from tricycle_sim.vehicle.layout import LANES

COLUMNS = "x", "y", "vx_world", "vy_world"
"""Columns of a `CommandedBatch` that are recorded."""
FOR_CARD = 2048
"""Samples from which on a graphics card is thought of."""

_LOGGER = logging.getLogger(__name__)
_CARD = threading.RLock()
_CARD_BYTES = 2**29  # of what a block records: enough vehicles to keep a card busy
_PART = 16 * LANES  # samples of such a block that are reduced at a time


@dataclass(frozen=True)
class PlanarBlock:
    """Path of a block of b samples: position and velocity of the COM in the world."""

    time: FloatArray  # s, shape (t,)
    x: FloatArray  # m, shape (b, t)
    y: FloatArray
    vx_world: FloatArray  # m/s, shape (b, t)
    vy_world: FloatArray
    feasibility: Feasibility


Reduce = Callable[[int, PlanarBlock], None]
"""Takes the number of a block's first sample, and the block."""


def simulate_planar(
    vehicle: Vehicle,
    commands: Commands,
    parameters: ArrayLike | None,
    reduce: Reduce,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
) -> None:
    """Simulate vehicles block by block of samples, without keeping the trajectories.

    Parameters
    ----------
    vehicle : Vehicle
        As for `simulate`.
    commands : Commands
        As for `simulate`.
    parameters : ndarray of float, shape (n, k) or None
        As for `simulate`.
    reduce : callable
        Called from several threads at a time and in any order; each sample comes once. Later blocks
        overwrite the arrays.
    threads : int, optional
        As for `simulate`; where a number is given, the graphics card is left alone.
    progress : callable, optional
        As for `simulate`.
    """
    samples, done = check_parameters(vehicle, parameters), 0
    batch = CommandedBatch(vehicle, commands)
    if threads is None and len(samples) >= FOR_CARD and card_is_faster(vehicle):
        done = drive_on_card(batch, samples, reduce, progress)
    if done < len(samples):
        drive_on_cores(batch, samples, reduce, threads, progress, done)


def drive_on_cores(
    batch: CommandedBatch,
    samples: FloatArray,
    reduce: Reduce,
    threads: int | None = None,
    progress: Progress | None = None,
    done: int = 0,
) -> None:
    """Simulate samples on the processor.

    Parameters
    ----------
    batch : CommandedBatch
        Batch with the commands.
    samples : ndarray of float, shape (n, k)
        Unknown parameters of the samples.
    reduce : callable
        As for `simulate_planar`.
    threads : int, optional
        As for `simulate`.
    progress : callable, optional
        As for `simulate`.
    done : int
        Number of samples at the beginning that have been simulated.
    """
    n = len(samples)

    def reduce_block(first: int, last: int) -> None:
        run = batch.run(samples[done + first : done + last], COLUMNS)
        reduce(done + first, _block(batch, run, 0, last - first))

    def tell(more: int, _: int) -> None:
        if progress is not None:
            progress(done + more, n)

    run_blocks(reduce_block, n - done, threads, tell)


def drive_on_card(
    batch: CommandedBatch, samples: FloatArray, reduce: Reduce, progress: Progress | None = None
) -> int:
    """Simulate samples on the graphics card; the cores reduce one block during the next.

    Parameters
    ----------
    batch : CommandedBatch
        Batch with the commands.
    samples : ndarray of float, shape (n, k)
        Unknown parameters of the samples.
    reduce : callable
        As for `simulate_planar`.
    progress : callable, optional
        As for `simulate`.

    Returns
    -------
    done : int
        Number of samples that were simulated: all, unless another thread has the card, or it fails.
    """
    from tricycle_sim.vehicle import graphics_card  # takes 0.3 s

    n, each = len(samples), len(COLUMNS) * len(batch.time)
    size = min(n, LANES * max(1, _CARD_BYTES // (8 * LANES * each)))
    waiting: list[Future[None]] = []
    done = 0
    if not _CARD.acquire(blocking=False):
        return done
    try:
        with ThreadPoolExecutor(usable_cores()) as pool:
            for number, first in enumerate(range(0, n, size)):
                block = samples[first : first + size]
                try:
                    memory = graphics_card.page_locked(2 if size < n else 1, (size + LANES) * each)
                    run = batch.run(block, COLUMNS, on_card=memory[number % 2])
                except Exception as error:  # other programs may have left it no memory
                    _without_card(error)
                    break
                for reduced in waiting:
                    reduced.result()

                def reduce_part(part: int, first: int = first, run: Run = run) -> None:
                    reduce(first + part, _block(batch, run, part, part + _PART))

                waiting = [pool.submit(reduce_part, part) for part in range(0, len(block), _PART)]
                done += len(block)
                if progress is not None:
                    progress(done, n)
            for reduced in waiting:
                reduced.result()
    finally:
        _CARD.release()
    return done


@functools.lru_cache(maxsize=64)
def card_is_faster(vehicle: Vehicle) -> bool:
    """Return whether there is a graphics card and it was faster in a trial of a second.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle that is to be simulated.
    """
    try:
        from tricycle_sim.vehicle import graphics_card

        if not graphics_card.is_there():
            return False
        samples = np.tile(vehicle.nominal_point(), (FOR_CARD, 1))
        batch = CommandedBatch(vehicle, Commands(np.array([0.0, 1.0]), np.zeros(2), np.zeros(2)))
        durations: dict[bool, float] = {}
        with _CARD:  # no other thread's samples are timed
            for on_card in (True, False) * 2:  # the first of each loads the code
                start = time.perf_counter()
                if not on_card:
                    drive_on_cores(batch, samples, lambda *_: None)
                elif not drive_on_card(batch, samples, lambda *_: None):
                    return False
                durations[on_card] = time.perf_counter() - start
    except Exception as error:  # of a driver or of numba: without a card everything works
        _without_card(error)
        return False
    return durations[True] < durations[False]


def _without_card(error: Exception) -> None:
    _LOGGER.warning("without the graphics card: %s", str(error).strip().partition("\n")[0])


def _block(batch: CommandedBatch, run: Run, first: int, last: int) -> PlanarBlock:
    """Return the paths of some samples, `first` a multiple of `LANES`."""
    columns = {name: column[first:last] for name, column in run.columns.items()}
    groups = run.groups[first // LANES : -(-last // LANES)]
    angles = run.steering_motor_angle[first:last]
    part = Run(columns, angles, groups, run.wheels, run.saturation)
    return PlanarBlock(batch.time, **columns, feasibility=part.feasibility)
