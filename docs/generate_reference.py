"""Writes the reference pages, and the tables within pages, that come from the code.

    python docs/generate_reference.py      # or: make reference

A test fails where a page is stale.
"""

import argparse
import dataclasses
import inspect
import json
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from numpydoc.docscrape import NumpyDocString

DOCS = Path(__file__).parent
GENERATED = (
    "<!-- Written by docs/generate_reference.py: change the code, then `make reference`. -->\n"
)


def table(headings: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Return a table in Markdown."""
    lines = [list(headings), *([str(cell) for cell in row] for row in rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "".join(f"| {' | '.join(c.replace('|', '&#124;') for c in line)} |\n" for line in lines)


# --- commands -------------------------------------------------------------------------------------


def commands_page() -> str:
    """Help of every command."""
    os.environ["COLUMNS"] = "100"
    from tricycle_cli.main import COMMANDS, parser

    top = parser()
    page = [GENERATED, "# Commands\n\n", _help(top)]
    subparsers = _subparsers(top)
    for name in COMMANDS:
        page += [f"## tricycle {name}\n\n", _help(subparsers[name])]
        for verb, inner in _subparsers(subparsers[name]).items():
            page += [f"### tricycle {name} {verb}\n\n", _help(inner)]
    return "".join(page)


def _subparsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def _help(parser: argparse.ArgumentParser) -> str:
    return f"```text\n{parser.format_help().rstrip()}\n```\n\n"


# --- protocol -------------------------------------------------------------------------------------


def protocol_page() -> str:
    """The protocol's page with its tables of messages and fields, from the message table."""
    from tricycle_bridge.protocol.messages import MESSAGES

    tables = {"messages": _message_table(MESSAGES), "load": _load_table()}
    tables |= {m.__name__: _field_table(m) for m in MESSAGES if dataclasses.fields(m)}

    def filled(match: re.Match[str]) -> str:
        return f"{match[1]}\n{tables.pop(match[2])}\n{match[3]}"

    text = (DOCS / "protocol.md").read_text(encoding="utf-8")
    text = re.sub(r"(<!-- table: (\w+) -->\n).*?(<!-- end -->)", filled, text, flags=re.DOTALL)
    if tables:
        raise SystemExit(f"protocol.md has no place for the table of {', '.join(tables)}")
    return re.sub(r"^\| `[0-9a-f]{18,}` (\|.*\|)$", _vector, text, flags=re.MULTILINE)


def _vector(row: re.Match[str]) -> str:
    """A row of the test vectors with the frame that its other cells describe."""
    from tricycle_bridge.protocol.framing import encode
    from tricycle_bridge.protocol.messages import MESSAGES, Board, layout

    name, board, seq, session, values = (cell.strip() for cell in row[1].split("|")[1:-1])
    (message,) = (
        m for m in MESSAGES if _wire_name(m) == name and m.BOARD in (Board(int(board)), Board.ANY)
    )
    given = [int(value, 0) for value in values.split(", ") if value]
    left_out = len(layout(message)) - len(given)
    frame = encode(
        message(*given, *[0] * left_out),
        board=Board(int(board)),
        seq=int(seq),
        session=int(session, 0),
    )
    return f"| `{frame.hex()}` {row[1]}"


def _load_table() -> str:
    """Share of one direction of the line that each stream takes."""
    from tricycle_bridge.protocol import messages as m

    streams = {m.SteerState: 100, m.DriveState: 100, m.SteerCommand: 50, m.DriveCommand: 50}
    rows = []
    for message, rate in streams.items():
        size = m.payload_struct(message).size + 10  # section 1.1
        load = f"{10 * size * rate / m.BAUD:.1%}".replace("%", " %")
        rows.append((f"{_wire_name(message)}, {rate} Hz", size, load))
    return table(("stream", "bytes per frame", "load"), rows)


def _message_table(messages: Iterable[Any]) -> str:
    from tricycle_bridge.protocol.messages import Board, from_plc, payload_struct

    return table(
        ("id", "message", "from", "board", "bytes", "in Python", ""),
        (
            (
                f"0x{m.ID:02X}",
                _wire_name(m),
                "PLC" if from_plc(m.ID) else "host",
                "both" if m.BOARD is Board.ANY else m.BOARD.name.lower(),
                payload_struct(m).size,
                f"`{m.__name__}`",
                _summary(m),
            )
            for m in messages
        ),
    )


def _wire_name(message: type) -> str:
    """Name of a message in the protocol's page, such as STEER_CMD."""
    name = re.sub(r"(?<!^)(?=[A-Z])", "_", message.__name__).upper()
    for long, short in (("COMMAND", "CMD"), ("REQUEST", "REQ"), ("CONTROL", "CTRL")):
        name = name.replace(long, short)
    return "LIMITS" if name.endswith("_LIMITS") else name


def _field_table(message: Any) -> str:
    from tricycle_bridge.protocol.messages import layout, meanings

    comments, counts = _meanings(message), meanings(message)
    rows = [
        (f"`{name}`", wire.name, _one_count(counts[name]), comments.get(name, ""))
        for name, wire in layout(message).items()
    ]
    return table(("field", "type", "one count", "meaning"), rows)


def _one_count(meaning: Any) -> str:
    """Amount that one count stands for, or the enumeration of the values."""
    if isinstance(meaning, type):
        return f"`{meaning.__name__}`"
    return "" if meaning is None else str(meaning)


def _summary(described: type) -> str:
    return (inspect.getdoc(described) or "").partition("\n\n")[0].replace("\n", " ")


def _meanings(described: type) -> dict[str, str]:
    """Meaning of each field, from the docstring's Attributes or the comment beside it."""
    source = inspect.getsource(described)
    comments = dict(re.findall(r"^    (\w+): .*?# (.*)$", source, re.MULTILINE))
    for names, _, text in _attributes(described):
        comments |= dict.fromkeys(names, text)
    return comments


# --- files ----------------------------------------------------------------------------------------


def files_page() -> str:
    """Plan and study."""
    from excitation_planner import plan
    from excitation_planner.design import store
    from excitation_planner.design.noise import MeasurementNoise
    from excitation_planner.design.study import Study

    inner = [
        f"\n`{kind.__name__}`: {_summary(kind)}\n\n" + _fields(kind)
        for kind in (plan.Reference, plan.SearchHistory)
    ]
    with tempfile.TemporaryDirectory() as folder:
        box = {"p1": (0.0, 1.0), "p2": (0.0, 1.0)}
        Study.create(Path(folder), {"x1": (0.0, 1.0)}, box, "p1", samples=20, budget=1000)
        example = json.dumps(json.loads((Path(folder) / "study.json").read_text()), indent=2)
    return "".join(
        [
            GENERATED,
            "# Files\n\nFiles are read as untrusted input: every field is checked, and nothing in "
            "them is run. Units are SI.\n\n## Plan\n\n",
            f"`plan.json`, schema {plan.SCHEMA}, at most {plan.MAX_BYTES // 1_000_000} MB. Besides "
            "the fields below it has `schema`, `id` (twelve digits of a hash of commands and "
            "reference) and `checksum`, of all fields: a plan that was changed is refused.\n\n",
            _fields(plan.Plan),
            "\nThe fields of `noise` stand beside the others, not in an object of their own:\n\n",
            _fields(MeasurementNoise),
            "\nAn index is an object with `value`, and `low` and `high`, its 95 % interval.\n",
            *inner,
            "\n## Study\n\nA study is a directory.\n\n```text\n",
            (inspect.getdoc(store) or "").partition("\n\n")[2],
            "\n```\n\n`study.json`, for example:\n\n```json\n",
            example,
            "\n```\n\n`pending.csv` lists the simulations to run next: `point`, `sample`, the "
            "operation and the unknown parameters, and `nuisance0` and on for what is beside "
            "them.\n\n## Others\n\n"
            "- Vehicle: [your own vehicle](how-to-vehicle.md).\n"
            "- Area: [a maneuver that fits the ground](how-to-area.md).\n"
            "- Commands of `tricycle simulate`: CSV with the columns `time`, "
            "`steering_motor_angle`, `speed` in s, rad, m/s.\n"
            "- Bags: rosbag2 directories, [bags](bags.md).\n",
        ]
    )


def _fields(described: type) -> str:
    """Table of the attributes in a numpydoc docstring, which must name every field."""
    entries = _attributes(described)
    named = {name for names, _, _ in entries for name in names}
    missing = {field.name for field in dataclasses.fields(described)} - named
    if missing:
        raise SystemExit(f"{described.__name__}: its docstring misses {', '.join(sorted(missing))}")
    rows = [(f"`{'`, `'.join(names)}`", kind, text) for names, kind, text in entries]
    return table(("field", "type", "meaning"), rows)


def _attributes(described: type) -> list[tuple[list[str], str, str]]:
    """Names, type and meaning of each entry under Attributes in a numpydoc docstring."""
    entries = NumpyDocString(inspect.getdoc(described) or "")["Attributes"]
    return [(entry.name.split(", "), entry.type, " ".join(entry.desc)) for entry in entries]


# --- nodes ----------------------------------------------------------------------------------------

NODES = {
    "excitation_planner": "excitation_planner.planner_node:ExcitationPlanner",
    "maneuver_driver": "excitation_planner.maneuver_driver_node:ManeuverDriver",
    "tricycle_bridge": "tricycle_bridge.bridge_node:BridgeNode",
    "tricycle_sim": "tricycle_sim.sim_node:TricycleSim",
    "trajectory_recorder": "trajectory_recorder.recorder_node:TrajectoryRecorder",
    "bag_replayer": "trajectory_recorder.replayer_node:BagReplayer",
    "identification_monitor": (
        "parameter_identification.identification_monitor_node:IdentificationMonitor"
    ),
}
OF_EVERY_NODE = ("use_sim_time", "start_type_description_service", "qos_overrides.")


def nodes_page() -> str:
    """Topics, services and parameters of every node, as it declares them."""
    page = [
        GENERATED,
        "# Topics, services and parameters\n\nThis page lists what the nodes declare. "
        "[Nodes](nodes.md), [the by-wire link](link.md) and [bags](bags.md) say what it is for. "
        "`~` is the node's name.\n",
    ]
    for name in NODES:
        with _node(name) as node:
            page += [f"\n## {name}\n\n", *_interfaces(node, name), *_parameters(node)]
    return "".join(page)


@contextmanager
def _node(name: str) -> Iterator[Any]:
    """A node with its defaults, alone on this machine, in a folder of its own."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.environ |= {"ROS_LOG_DIR": folder, "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}
        os.chdir(folder)
        arguments = []
        if name == "bag_replayer":
            arguments = ["--ros-args", "-p", f"bag:={_small_bag(Path(folder) / 'bag')}"]
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        node = resolve_name(NODES[name])()
        try:
            yield node
        finally:
            node.destroy_node()
            rclpy.shutdown()
            os.chdir(before)


def _small_bag(path: Path) -> Path:
    """A bag with one message, for the replayer to open."""
    from trajectory_recorder.bag.topics import Topic, jazzy
    from trajectory_recorder.bag.writer import BagWriter

    kind = "std_msgs/msg/String"
    message = jazzy().types[kind](data="")
    with BagWriter(path) as bag:
        topic = bag.add_topic(Topic.of_type("/recorded", kind))
        bag.write(topic, 1, bytes(jazzy().serialize_cdr(message, kind)))
    return path


def _interfaces(node: Any, name: str) -> Iterator[str]:
    from rclpy.qos import DurabilityPolicy

    def shown(topic: str) -> str:
        return topic.replace(f"/{name}/", "~/") if topic.startswith(f"/{name}/") else topic

    def kind(of: type) -> str:
        package, folder = of.__module__.split(".")[:2]
        return f"{package}/{folder}/{of.__name__}"

    def qos(profile: Any) -> str:
        latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        return ", ".join([profile.reliability.name.lower(), *(["latched"] if latched else [])])

    def topics(entities: Iterable[Any]) -> list[tuple[str, str, str]]:
        rows = {(shown(e.topic_name), kind(e.msg_type), qos(e.qos_profile)) for e in entities}
        common = ("/rosout", "/parameter_events", "~/transition_event")
        return sorted(row for row in rows if row[0] not in common)

    for title, rows in (
        ("publishes", topics(node.publishers)),
        ("subscribes", topics(node.subscriptions)),
    ):
        if rows:
            rows = [(f"`{topic}`", message, offered) for topic, message, offered in rows]
            yield table((title, "type", "quality of service"), rows) + "\n"
    services = sorted(
        (shown(service.srv_name), kind(service.srv_type))
        for service in node.services
        if not service.srv_type.__module__.startswith(
            ("rcl_interfaces", "lifecycle_msgs", "type_description_interfaces")
        )
    )
    if services:
        yield table(("service", "type"), ((f"`{s}`", k) for s, k in services)) + "\n"


def nodes_help() -> str:
    """What `--help` of the nodes says: by class, the node's name and rows of its parameters."""
    rows = {}
    for name, where in NODES.items():
        with _node(name) as node:
            shown = [[cell.strip("`") for cell in row] for row in _parameter_rows(node)]
            rows[where.partition(":")[2]] = [name, shown]
    return json.dumps(rows, indent=1, ensure_ascii=False) + "\n"


def _parameters(node: Any) -> Iterator[str]:
    yield table(("parameter", "default", "range", "set", "meaning"), _parameter_rows(node))


def _parameter_rows(node: Any) -> list[tuple[str, ...]]:
    names = sorted(name for name in node._parameters if not name.startswith(OF_EVERY_NODE))
    rows = []
    for name, of in zip(names, node.describe_parameters(names), strict=True):
        ranges = [*of.floating_point_range, *of.integer_range]
        span = f"{ranges[0].from_value:g} … {ranges[0].to_value:g}" if ranges else ""
        default = node.get_parameter(name).value if name != "bag" else ""
        shown = "" if default in ("", [""]) else f"`{default}`"
        fixed = "at start" if of.read_only else of.additional_constraints or "any time"
        rows.append((f"`{name}`", shown, span, fixed, of.description))
    return rows


PAGES: dict[str, Callable[[], str]] = {
    "reference-commands.md": commands_page,
    "protocol.md": protocol_page,
    "reference-files.md": files_page,
    "reference-nodes.md": nodes_page,
    "../src/tricycle_core/tricycle_core/nodes.json": nodes_help,
}


def main() -> None:
    """Write the pages, or those named on the command line."""
    for name in sys.argv[1:] or PAGES:
        (DOCS / name).write_text(PAGES[name](), encoding="utf-8")


if __name__ == "__main__":
    main()
