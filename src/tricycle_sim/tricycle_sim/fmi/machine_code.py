"""The equations of motion of a vehicle as an object file that needs neither Python nor numba.

numba compiles C-callable functions; their LLVM code is compiled again for any x86-64 processor.
None of them allocates memory.
"""

from typing import Any

import numba
import numpy as np
from llvmlite import binding as llvm
from numba import carray, types

from tricycle_sim.compilation import FASTMATH
from tricycle_sim.setpoints import slew as slew_setpoint
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.groups import SETTLE_STEPS, SETTLE_WIDTH
from tricycle_sim.vehicle.kernel import functions_for
from tricycle_sim.vehicle.layout import LANES, SLOPE, STATE
from tricycle_sim.vehicle.parts import ROWS, servo_at_rest
from tricycle_sim.vehicle.steering import SIZE

_POINTER, _NONE = types.CPointer(types.float64), types.CPointer(types.int64)
TABLE_ROWS = 3
"""Rows of the table of the steering over a tick, one Runge-Kutta step as in batches."""


def functions(vehicle: Vehicle) -> dict[str, Any]:
    """Return the functions of a vehicle by their names in C, as numba compiles them for C.

    `vehicle_step` moves on by a tick; `vehicle_settle` finds by Newton's method where the vehicles
    of a group stand, from a first guess of height, roll and pitch; `vehicle_evaluate` writes slopes
    and loads; `vehicle_slew` is that of the boards. `fmu.c` declares them.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle whose structure is compiled in, but none of its constants.
    """
    compiled = functions_for(vehicle)
    advance, steer = compiled.advance, compiled.steer
    servo_size = len(servo_at_rest(vehicle))
    size = ROWS * LANES
    x_w, x_p, x_q = ((SLOPE + row) * LANES for row in (STATE.w, STATE.p, STATE.q))
    x_z, x_q0 = STATE.z * LANES, STATE.q0 * LANES
    iterations, width = SETTLE_STEPS, SETTLE_WIDTH

    def evaluate(group: Any, table: Any, drive: Any, work: Any, lags: Any, none: Any) -> None:
        rows = carray(none, (0,))
        out = carray(work, (0, LANES, 2))
        lag = carray(lags, (2,))
        advance(
            carray(group, (1, size)),
            carray(table, (1, 8)),
            lag[:1],
            carray(drive, (1, 3)),
            1,
            0,
            rows,
            1,
            out,
        )

    def step(
        group: Any,
        servo: Any,
        constants: Any,
        table: Any,
        drive: Any,
        setpoint: Any,
        work: Any,
        lags: Any,
        none: Any,
    ) -> None:
        rows = carray(none, (0,))
        out = carray(work, (0, LANES, 2))
        lag = carray(lags, (2,))
        angles = carray(work, (2, 2))
        axles = carray(table, (TABLE_ROWS, 8))
        steer(
            carray(servo, (servo_size,)),
            carray(setpoint, (1,)),
            carray(constants, (SIZE,)),
            2,
            axles,
            angles,
        )
        advance(carray(group, (1, size)), axles, lag, carray(drive, (2, 3)), 1, 0, rows, 1, out)

    def settle(
        group: Any,
        servo: Any,
        constants: Any,
        table: Any,
        drive: Any,
        pose: Any,
        work: Any,
        lags: Any,
        steps: Any,
        none: Any,
    ) -> None:
        rows = carray(none, (0,))
        out = carray(work, (0, LANES, 2))
        lag = carray(lags, (2,))
        angles = carray(work, (2, 1))
        axles = carray(table, (TABLE_ROWS, 8))
        no_setpoints = carray(work, (0,))
        steer(
            carray(servo, (servo_size,)),
            no_setpoints,
            carray(constants, (SIZE,)),
            1,
            axles,
            angles,
        )
        g, at = carray(group, (1, size)), carray(pose, (3,))
        jacobian, step = carray(work, (3, 3)), carray(steps, (3,))
        for _ in range(iterations):
            # lanes: here, a step forward and one back of each of the three
            for i in range(LANES):
                z, roll, pitch = at[0], at[1], at[2]
                change = width if i < 4 else -width
                which = (i - 1) % 3 if 0 < i < 7 else -1
                if which == 0:
                    z += change
                elif which == 1:
                    roll += change
                elif which == 2:
                    pitch += change
                cr, sr = np.cos(0.5 * roll), np.sin(0.5 * roll)
                cp, sp = np.cos(0.5 * pitch), np.sin(0.5 * pitch)
                g[0, x_z + i] = z
                g[0, x_q0 + i] = cr * cp
                g[0, x_q0 + LANES + i] = sr * cp
                g[0, x_q0 + 2 * LANES + i] = cr * sp
                g[0, x_q0 + 3 * LANES + i] = -sr * sp
            advance(g, axles[:1], lag[:1], carray(drive, (1, 3)), 1, 0, rows, 1, out)
            for j in range(3):
                jacobian[0, j] = (g[0, x_w + 1 + j] - g[0, x_w + 4 + j]) / (2.0 * width)
                jacobian[1, j] = (g[0, x_p + 1 + j] - g[0, x_p + 4 + j]) / (2.0 * width)
                jacobian[2, j] = (g[0, x_q + 1 + j] - g[0, x_q + 4 + j]) / (2.0 * width)
            b0, b1, b2 = g[0, x_w], g[0, x_p], g[0, x_q]
            a = jacobian
            c0 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
            c1 = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
            c2 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
            whole = a[0, 0] * c0 + a[0, 1] * c1 + a[0, 2] * c2
            step[0] = (
                b0 * c0
                + b1 * (a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2])
                + b2 * (a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1])
            ) / whole
            step[1] = (
                b0 * c1
                + b1 * (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0])
                + b2 * (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2])
            ) / whole
            step[2] = (
                b0 * c2
                + b1 * (a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1])
                + b2 * (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0])
            ) / whole
            for j in range(3):
                at[j] -= step[j]

    def slew(setpoint: float, target: float, rate: float) -> float:
        moved: float = slew_setpoint(setpoint, target, rate)
        return moved

    nothing, number = types.void, types.float64
    options: dict[str, Any] = {"fastmath": FASTMATH, "error_model": "numpy"}
    signatures = {
        "vehicle_evaluate": (evaluate, nothing(*5 * (_POINTER,), _NONE)),
        "vehicle_step": (step, nothing(*8 * (_POINTER,), _NONE)),
        "vehicle_settle": (settle, nothing(*9 * (_POINTER,), _NONE)),
        "vehicle_slew": (slew, number(number, number, number)),
    }
    return {
        name: numba.cfunc(signature, **options)(function)
        for name, (function, signature) in signatures.items()
    }


def object_file(vehicle: Vehicle) -> bytes:
    """Return the functions of a vehicle compiled for any x86-64 processor, as an object file.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle; its wheels and laws are used.
    """
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    modules = [_module(name, function) for name, function in functions(vehicle).items()]
    whole, *others = modules
    for other in others:
        whole.link_in(other)
    target = llvm.Target.from_triple("x86_64-unknown-linux-gnu")
    machine = target.create_target_machine(
        cpu="x86-64", features="", opt=3, reloc="pic", codemodel="default"
    )
    passes = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    passes.getModulePassManager().run(whole, passes)
    whole.verify()
    return bytes(machine.emit_object(whole))


def _module(name: str, function: Any) -> Any:
    """Return the LLVM code of a function of which only the C name is visible from outside."""
    # numba has no public way to its code before that is bound to this processor
    code = function._library.get_llvm_str().replace(function._wrapper_name, name)  # noqa: SLF001
    module = llvm.parse_assembly(code)
    for part in (*module.functions, *module.global_variables):
        if not part.is_declaration and part.name != name:
            part.linkage = "internal"
    return module
