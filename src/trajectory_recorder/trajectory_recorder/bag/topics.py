"""Topics of a bag: type, definition, type hash, offered quality of service.

rosbags is imported where it is used: it takes a while, and the types are wanted without it.
"""

from __future__ import annotations

import importlib
import os
import re
import reprlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from trajectory_recorder.bag.metadata import load_yaml
from tricycle_core.errors import BagError
from tricycle_core.stamps import SECOND

if TYPE_CHECKING:
    from rosbags.interfaces import Qos
    from rosbags.typesys.store import Typestore

FOREVER = 2**63 - 1  # ns; how ROS 2 writes an infinite deadline, lifespan or lease


@dataclass(frozen=True)
class OfferedQos:
    """Quality of service that one publisher offered, with the names of rosbag2's metadata.

    Attributes
    ----------
    history : str
        "keep_last", "keep_all", ...
    depth : int
        Messages kept by "keep_last"; 0 where the middleware does not say.
    reliability : str
        "reliable", "best_effort", ...
    durability : str
        "volatile", "transient_local", ...
    deadline, lifespan : int
        Largest time between messages, and age of a message [ns]; FOREVER where unlimited.
    liveliness : str
        "automatic", "manual_by_topic", ...
    lease : int
        Time within which the publisher must show its liveliness [ns]; FOREVER where unlimited.
    """

    history: str = "keep_last"
    depth: int = 10
    reliability: str = "reliable"
    durability: str = "volatile"
    deadline: int = FOREVER
    lifespan: int = FOREVER
    liveliness: str = "automatic"
    lease: int = FOREVER

    @property
    def latched(self) -> bool:
        """Whether late subscribers are given the last messages."""
        return self.durability == "transient_local"

    @classmethod
    def of_connection(cls, qos: Qos) -> OfferedQos:
        """Return the quality of service that `rosbags` read."""
        return cls(
            history=qos.history.name.lower(),
            depth=qos.depth,
            reliability=qos.reliability.name.lower(),
            durability=qos.durability.name.lower(),
            deadline=qos.deadline.sec * SECOND + qos.deadline.nsec,
            lifespan=qos.lifespan.sec * SECOND + qos.lifespan.nsec,
            liveliness=qos.liveliness.name.lower(),
            lease=qos.liveliness_lease_duration.sec * SECOND + qos.liveliness_lease_duration.nsec,
        )

    @classmethod
    def of_yaml(cls, entry: Mapping[str, Any]) -> OfferedQos:
        """Return the quality of service of an entry of ``offered_qos_profiles``.

        Parameters
        ----------
        entry : mapping
            Policies as names (metadata version 9) or as numbers (before).

        Raises
        ------
        KeyError, TypeError, ValueError
            If it is none.
        """
        from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability

        def nanoseconds(time: Mapping[str, int]) -> int:
            return int(time["sec"]) * SECOND + int(time["nsec"])

        return cls(
            history=_policy(QosHistory, entry["history"]),
            depth=int(entry["depth"]),
            reliability=_policy(QosReliability, entry["reliability"]),
            durability=_policy(QosDurability, entry["durability"]),
            deadline=nanoseconds(entry["deadline"]),
            lifespan=nanoseconds(entry["lifespan"]),
            liveliness=_policy(QosLiveliness, entry["liveliness"]),
            lease=nanoseconds(entry["liveliness_lease_duration"]),
        )

    def to_yaml(self) -> dict[str, Any]:
        """Return the entry of ``offered_qos_profiles``, rosbag2 metadata version 9."""

        def split(ns: int) -> dict[str, int]:
            return {"sec": ns // SECOND, "nsec": ns % SECOND}

        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": split(self.deadline),
            "lifespan": split(self.lifespan),
            "liveliness": self.liveliness,
            "liveliness_lease_duration": split(self.lease),
            "avoid_ros_namespace_conventions": False,
        }


def parse_profiles(text: str) -> tuple[OfferedQos, ...]:
    """Return the publishers in the metadata of an MCAP channel; empty if unreadable.

    Parameters
    ----------
    text : str
        YAML of ``offered_qos_profiles``.
    """
    try:
        return tuple(OfferedQos.of_yaml(entry) for entry in load_yaml(text) or ())
    except (yaml.YAMLError, KeyError, TypeError, ValueError, RecursionError):  # of another vendor
        return ()


def _policy(kind: type[Enum], value: str | int) -> str:
    """Name of a policy as a number or a name; "unknown" where it is none."""
    try:
        found = kind(value) if isinstance(value, int) else kind[str(value).upper()]
    except (KeyError, ValueError):
        return "unknown"
    return found.name.lower()


@dataclass(frozen=True)
class Topic:
    """A recorded topic.

    Attributes
    ----------
    name : str
        Absolute name: ``/odom``.
    type : str
        Type of its messages: ``nav_msgs/msg/Odometry``.
    definition : str
        Definition of the type in ``.msg`` syntax with its dependencies; empty if unknown. Bytes of
        a binary definition that are no text are surrogates (`surrogateescape`).
    type_hash : str
        Hash of the type: ``RIHS01_...``; empty if unknown.
    qos : tuple of OfferedQos
        Quality of service of each publisher when recording began.
    count : int
        Number of messages in the bag.
    encoding : str
        Encoding of the messages; other ones than CDR are copied, but not decoded.
    definition_encoding : str
        Encoding of the definition, as MCAP names it: ``ros2msg``, ``ros2idl``, ``jsonschema``, ...
    """

    name: str
    type: str
    definition: str = ""
    type_hash: str = ""
    qos: tuple[OfferedQos, ...] = ()
    count: int = 0
    encoding: str = "cdr"
    definition_encoding: str = "ros2msg"

    def check_same(self, other: Topic) -> None:
        """Refuse a topic of this name with messages of another kind.

        Parameters
        ----------
        other : Topic
            Topic of the same name.

        Raises
        ------
        BagError
            If type, its definition or encoding differ.
        """
        if self.type != other.type:
            raise BagError(f"{self.name} has two types, {self.type} and {other.type}")
        if self.type_hash != other.type_hash and self.type_hash and other.type_hash:
            raise BagError(
                f"{self.name} has two definitions of its type {self.type}, of different versions"
            )
        if self.encoding != other.encoding:
            raise BagError(f"{self.name} has two encodings, {self.encoding} and {other.encoding}")

    @property
    def latched(self) -> bool:
        """Whether every publisher offered the last messages to late subscribers."""
        return bool(self.qos) and all(qos.latched for qos in self.qos)

    @property
    def latched_depth(self) -> int:
        """Number of last messages that all publishers together keep for late subscribers."""
        return sum(max(qos.depth, 1) for qos in self.qos)

    @classmethod
    def of_type(cls, name: str, type_name: str, *, qos: tuple[OfferedQos, ...] = ()) -> Topic:
        """Return a topic of a type of ROS 2 Jazzy or of an installed package.

        Parameters
        ----------
        name : str
            Name of the topic.
        type_name : str
            Type of its messages; definition and hash are looked up.
        qos : tuple of OfferedQos
            Quality of service of each publisher.

        Raises
        ------
        BagError
            If there is no such type, or its definition cannot be read.
        """
        store = jazzy()
        try:
            _register(type_name)
            definition, _ = store.generate_msgdef(type_name, ros_version=2)
            type_hash = store.hash_rihs01(type_name)
        except BagError:
            raise
        except Exception as error:  # of rosbags, on a file of any content
            raise BagError(
                f"the definition of the message type {type_name!r}, or of one in it, is not of "
                "plain fields"
            ) from error
        return cls(name, type_name, definition, type_hash, qos)


@cache
def jazzy() -> Typestore:
    """Return the message types of ROS 2 Jazzy: definitions, hashes and CDR, without ROS."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def _parts(type_name: str) -> tuple[str, str]:
    """Package and name of a message type; nothing else becomes a path or is imported."""
    found = re.fullmatch(r"([A-Za-z]\w*)/msg/([A-Za-z]\w*)", type_name, re.ASCII)
    if found is None:
        raise BagError(
            f"{reprlib.repr(type_name)} is not a message type, as in std_msgs/msg/String"
        )
    return found[1], found[2]


def _register(type_name: str) -> None:
    """Make an installed message type, and those it is made of, known to `jazzy`."""
    from rosbags.typesys import get_types_from_msg

    store = jazzy()
    if type_name in store.types:
        return
    package, kind = _parts(type_name)
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    files = (Path(prefix, "share", package, "msg", f"{kind}.msg") for prefix in prefixes if prefix)
    file = next((file for file in files if file.exists()), None)
    if file is None:
        raise BagError(f"there is no definition of the message type {type_name!r}")
    types = get_types_from_msg(file.read_text(encoding="utf-8"), type_name)
    for part in sorted(set(re.findall(r"'(\w+/msg/\w+)'", repr(types))) - {type_name}):
        _register(part)
    store.register(types)


def message_class(type_name: str) -> type:
    """Return the class of an installed ROS message type.

    Parameters
    ----------
    type_name : str
        Name of the type: ``nav_msgs/msg/Odometry``.

    Raises
    ------
    BagError
        If its package is not installed.
    """
    package, kind = _parts(type_name)
    try:
        found: type = getattr(importlib.import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError) as error:
        raise BagError(f"its type {type_name} is not installed") from error
    return found


def deserialize(type_name: str, data: bytes) -> Any:
    """Deserialise a CDR message of a Jazzy type.

    Parameters
    ----------
    type_name : str
        Name of the type: ``nav_msgs/msg/Odometry``.
    data : bytes
        Serialised message.

    Raises
    ------
    BagError
        If the type is unknown or the bytes are not a message of it.
    """
    store = jazzy()
    if type_name not in store.types:
        raise BagError(f"cannot decode messages of the unknown type {type_name!r}")
    try:
        return store.deserialize_cdr(data, type_name)
    except Exception as error:
        raise BagError(f"{len(data)} bytes are not a message {type_name}: {error}") from error
