"""``tricycle plc``: what is on a serial port."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from tricycle_bridge.protocol.messages import (
    BAUD,
    Board,
    DriveState,
    SteerState,
)
from tricycle_bridge.protocol.readable import fault_names, state_name
from tricycle_bridge.protocol.units import ANGLE_UNIT, SPEED_UNIT
from tricycle_cli.argument_types import nonnegative_number
from tricycle_cli.options import add_overwrite_option, check_output_files, refuse_given
from tricycle_core.documents import encode
from tricycle_core.errors import LinkError

if TYPE_CHECKING:
    from tricycle_bridge.commissioning.probe import PortProbe
    from tricycle_bridge.commissioning.record import StepResult
    from tricycle_bridge.plc_link.link import LinkEvent, PlcLink

RECORD = Path("bring_up.json")
EXAMPLE = """\
examples:
  tricycle plc probe /dev/ttyACM0
  tricycle plc monitor /dev/ttyACM0 --seconds 10
  tricycle plc stats /dev/ttyACM0 --json
  tricycle plc check /dev/tricycle_steer /dev/tricycle_drive --engineer "A. Test"

The handshake disarms the board; close the bridge first. check moves steering
and wheel: before it, lift the steered wheels off the ground and put the driven
wheel on rollers as heavy to turn as the vehicle. A wheel in the air is lighter
than the drive board expects: a fault, PULSES or OVERSPEED.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "probe: who answers. monitor: telemetry and events as they come. "
        "stats: limits and counters of both ends after a while. "
        "check: bring-up of both boards on the vehicle, step by step, with a record."
    )
    parser.epilog = EXAMPLE
    add = parser.add_argument
    add("what", choices=["probe", "monitor", "stats", "check"])
    add(
        "ports",
        nargs="+",
        type=_port,
        metavar="PORT",
        help="serial device; check: that of the steer PLC, then that of the drive PLC",
    )
    add("--baud", type=_baud, default=BAUD, help=f"bits per second (default: {BAUD})")
    add(
        "--boot-wait",
        type=nonnegative_number,
        default=2.0,
        metavar="S",
        help="silence after opening, for a UNO's bootloader (default: 2)",
    )
    add(
        "--seconds",
        type=nonnegative_number,
        metavar="S",
        help="how long to watch (default: stats 2, monitor until Ctrl-C)",
    )
    add("--json", action="store_true", help="print one JSON object at the end")
    check = parser.add_argument_group("check")
    check.add_argument("--engineer", metavar="NAME", help="who signs the record off")
    check.add_argument(
        "--record",
        type=Path,
        metavar="FILE",
        help=f"where the record goes (default: {RECORD})",
    )
    check.add_argument(
        "--vehicle", metavar="FILE", help="vehicle file (default: the shipped tricycle)"
    )
    add_overwrite_option(check)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Probe, watch or count.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    if args.what in ("probe", "check"):
        refuse_given(args, ["seconds"], "only with monitor and stats")
    if args.what == "check":
        return _check(args)
    refuse_given(args, ("engineer", "record", "vehicle", "overwrite"), "only with check")
    if len(args.ports) != 1:
        raise LinkError(f"plc {args.what} takes one port, not {len(args.ports)}")

    from tricycle_bridge.commissioning.probe import PortProbe

    with PortProbe(args.ports[0], baud=args.baud, boot_wait=args.boot_wait) as probe:
        link = probe.handshake(timeout=args.boot_wait + 3.0)
        if args.what == "monitor":
            seconds = math.inf if args.seconds is None else args.seconds
            _monitor(probe, seconds, file=sys.stderr if args.json else sys.stdout)
        elif args.what == "stats":
            for _ in probe.events(2.0 if args.seconds is None else args.seconds):
                pass
            if not link.up:
                raise LinkError(f"{args.ports[0]}: {link.down_reason}")
        result = _describe(link, counters=args.what != "probe")
    if args.json:
        print(json.dumps(result))
    elif args.what != "monitor":
        for name, value in result.items():
            print(f"{name:22} {_readable(value)}")
    return 0


def _port(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError("needs the path of a serial device, as /dev/ttyACM0")
    return text


def _baud(text: str) -> int:
    if not text.isdecimal() or not 9600 <= int(text) <= 1_000_000:
        raise argparse.ArgumentTypeError(f"{text!r} must be a whole number from 9600 to 1000000")
    return int(text)


def _check(args: argparse.Namespace) -> int:
    if len(args.ports) != 2:
        raise LinkError("plc check takes two ports: that of the steer PLC, that of the drive PLC")
    if len({os.path.realpath(port) for port in args.ports}) < 2:
        raise LinkError(f"plc check: {' and '.join(args.ports)} are one port; each PLC has its own")
    if not (args.engineer or "").strip():
        raise LinkError("plc check needs --engineer NAME: somebody signs the record off")

    file: Path = args.record or RECORD
    check_output_files([file], args)

    from tricycle_bridge.commissioning.bring_up import STANDING, STEPS, bring_up
    from tricycle_bridge.commissioning.record import BringUpRecord, write_record
    from tricycle_bridge.commissioning.stand import PortStand
    from tricycle_bringup.configuration import bridge_settings
    from tricycle_sim.vehicle import load_vehicle

    log = sys.stderr if args.json else sys.stdout

    def say(text: str) -> None:
        print(f"    >> {text}", file=log, flush=True)

    paths = dict(zip((Board.STEER, Board.DRIVE), args.ports, strict=True))
    print(f"Make sure that {STANDING}. Ctrl-C stops and disarms.", file=log)
    results: list[StepResult] = []
    firmware: list[str] = []
    vehicle = load_vehicle(Path(args.vehicle) if args.vehicle else None)
    settings = bridge_settings(vehicle)
    try:
        with PortStand(
            paths,
            settings,
            say,
            end_stop=vehicle.steering_limit,
            baud=args.baud,
            boot_wait=args.boot_wait,
        ) as stand:
            stand.connect(args.boot_wait + 5.0)
            firmware = [stand.firmware(board) for board in paths]
            for number, result in enumerate(bring_up(stand), 1):
                results.append(result)
                measured = ", ".join(f"{k} {_readable(v)}" for k, v in result.measured.items())
                outcome = measured or "passed" if result.passed else f"FAILED: {result.problem}"
                print(f"{number:2}/{len(STEPS)} {result.name}: {outcome}", file=log, flush=True)
    finally:
        # also where Ctrl-C ended it: the record of an earlier one must not hold any more
        if firmware:
            record = write_record(
                file,
                BringUpRecord(
                    engineer=args.engineer.strip(),
                    time=datetime.now(UTC).isoformat(timespec="seconds"),
                    steer_firmware=firmware[0],
                    drive_firmware=firmware[1],
                    steps=tuple(results),
                    complete=len(results) == len(STEPS) and all(r.passed for r in results),
                    settings=dataclasses.asdict(settings),
                ),
            )
            print(f"record: {file}", file=log)
    if args.json:
        print(json.dumps(encode(record)))
    return 0 if record.complete else 1


def _monitor(probe: PortProbe, seconds: float, *, file: TextIO) -> None:
    from tricycle_bridge.plc_link.link import LinkEventKind

    try:
        for count, event in enumerate(probe.events(seconds)):
            # ten lines per second of telemetry are what a person can follow
            if event.kind is not LinkEventKind.TELEMETRY:
                print(event.text, file=file, flush=True)
            elif count % 10 == 0 and event.state is not None:
                print(_telemetry_line(event), file=file, flush=True)
    except KeyboardInterrupt:
        return


def _telemetry_line(event: LinkEvent) -> str:
    state = event.state
    faults = fault_names(state.faults) if state else ""
    if isinstance(state, SteerState):
        values = (
            f"angle {state.angle * ANGLE_UNIT:+.4f} rad, set-point "
            f"{state.setpoint * ANGLE_UNIT:+.4f} rad, servo {state.servo} us, adc {state.adc}"
        )
    elif isinstance(state, DriveState):
        values = (
            f"speed {state.speed * SPEED_UNIT:+.3f} m/s, set-point "
            f"{state.setpoint * SPEED_UNIT:+.3f} m/s, hall {state.hall_count}, "
            f"gear {state.gear}, brake {state.brake / 2:.0f} %"
        )
    else:
        return ""
    return f"{state_name(state.state):8} {values}, {state.supply * 1e-3:.1f} V {faults}".rstrip()


def _describe(link: PlcLink, *, counters: bool) -> dict[str, Any]:
    identity = link.identity
    result: dict[str, Any] = {"board": link.board.name.lower()}
    if identity is not None:
        version = (identity.version_major, identity.version_minor, identity.version_patch)
        result |= {
            "firmware": ".".join(map(str, version)),
            "protocol_minor": identity.minor,
            "boots": identity.boot_count,
            "build": f"{identity.build_hash:08x}",
        }
    if counters:
        result |= {
            "round_trip_ms": None if link.clock.round_trip is None else link.clock.round_trip * 1e3,
            "limits": None if link.limits is None else dataclasses.asdict(link.limits),
            "plc": None if link.stats is None else dataclasses.asdict(link.stats),
            "host_decoder": dataclasses.asdict(link.decoder.counters),
            "host_link": dataclasses.asdict(link.counters),
        }
    return result


def _readable(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {v}" for k, v in value.items() if not k.startswith("reserved"))
    return f"{value:.2f}" if isinstance(value, float) else str(value)
