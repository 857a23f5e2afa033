"""Files from anybody: whatever is in them, only the package's own error comes out.

Valid files are damaged at random, as bytes and as documents; and the known ways to make a small
file expensive are tried one by one.
"""

import copy
import json
import struct
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin, Writer

from excitation_planner import Study
from excitation_planner.maneuver import Circle
from excitation_planner.plan import load_plan, save_plan
from excitation_planner.planning import PlanRequest, plan_at
from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.topics import Topic, deserialize, jazzy, message_class
from trajectory_recorder.bag.writer import BagWriter, Compression
from tricycle_core.errors import BagError, CommandsError, DesignError, PlanError, VehicleError
from tricycle_sim.commands import load_commands
from tricycle_sim.vehicle import load_vehicle

VEHICLE = (files("tricycle_sim") / "tricycle.yaml").read_bytes()
COMMANDS = b"time,steering_motor_angle,speed\n0,0,0\n1,0.1,0.5\n2,0,1\n"
RESULTS = b"point,sample,output\n0,0,1.5\n0,1,failed\n0,2,infeasible: why\n"

fuzzed = settings(
    max_examples=40,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

# values that parsers of numbers, texts and lists stumble over
values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.sampled_from([10**400, -(10**20), float("inf"), "", "\x1b[2J", "a\nb", "../../x", []])
    | st.floats(allow_nan=False)
    | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
    ),
    max_leaves=5,
)


@st.composite
def damaged(draw, content):
    """The bytes with a few places overwritten, cut out, repeated or filled with others."""
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(data)))
        stop = min(len(data), start + draw(st.sampled_from([0, 1, 1, 2, 8, 100])))
        data[start:stop] = draw(
            st.binary(max_size=8)
            | st.just(bytes(data[start:stop]) * 2)
            | st.sampled_from([b"\0", b"\xff" * 8, b"[" * 2000, b"9" * 5000, b"!!python/name:os"])
        )
    return bytes(data)


def places(document, path=()):
    """Path of every value in a document of dicts and lists."""
    if isinstance(document, dict | list):
        keys = document.keys() if isinstance(document, dict) else range(len(document))
        for key in list(keys)[:60]:
            yield (*path, key)
            yield from places(document[key], (*path, key))


@st.composite
def changed(draw, document):
    """The document with a value replaced or removed."""
    document = copy.deepcopy(document)
    *path, last = draw(st.sampled_from(list(places(document))))
    inner = document
    for key in path:
        inner = inner[key]
    if draw(st.booleans()):
        inner[last] = draw(values)
    else:
        del inner[last]
    return document


def survives(read, error, path, content):
    """Read the file; its package's error may come out, and nothing else."""
    path.write_bytes(content)
    try:
        read(path)
    except error:
        return


# --- vehicle --------------------------------------------------------------------------------------


@pytest.mark.slow
@fuzzed
@given(content=damaged(VEHICLE))
def test_vehicle_bytes(tmp_path, content):
    survives(load_vehicle, VehicleError, tmp_path / "vehicle.yaml", content)


@pytest.mark.slow
@fuzzed
@given(document=changed(yaml.safe_load(VEHICLE)))
def test_vehicle_document(tmp_path, document):
    content = yaml.safe_dump(document).encode()
    survives(load_vehicle, VehicleError, tmp_path / "vehicle.yaml", content)


@pytest.mark.slow
@pytest.mark.parametrize(
    "content",
    [
        b"a: &a [x, x]\nb: &b [*a, *a]\nname: *b\n",  # doubles with every line
        b"a: &a {x: 1}\nconstants: {<<: [*a, *a]}\n",
        b"name: !!python/object/apply:os.system [true]\n",
        b"name: 2026-13-45\n",
        b"name: 0x" + b"f" * 100_000,
        b"[" * 100_000,
        b" " * 1_000_001,
        b"\xff\xfe",
    ],
)
def test_vehicle_files_that_cost_much(tmp_path, content):
    file = tmp_path / "vehicle.yaml"
    file.write_bytes(content)
    with pytest.raises(VehicleError):
        load_vehicle(file)


# --- plan -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    file = tmp_path_factory.mktemp("plan") / "plan.json"
    request = PlanRequest(load_vehicle(), Circle(duration=1.0), "cornering_stiffness", samples=50)
    save_plan(plan_at(request, np.array([3.0, 0.8])), file)
    return file.read_bytes()


@fuzzed
@given(data=st.data())
def test_plan_bytes(tmp_path, plan, data):
    survives(load_plan, PlanError, tmp_path / "plan.json", data.draw(damaged(plan)))


@pytest.mark.slow
@fuzzed
@given(data=st.data())
def test_plan_document(tmp_path, plan, data):
    content = json.dumps(data.draw(changed(json.loads(plan)))).encode()
    survives(load_plan, PlanError, tmp_path / "plan.json", content)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("cost", 10**400),
        ("verdict", "\ud800"),
        ("verdict", "\x1b[2J"),
        ("operation", {"ra\ndius": 1.0}),
        ("tyre_radius", 0.0),
        ("commands", {"time": [10**400]}),
        ("maneuver", {}),
    ],
)
def test_plan_fields_that_are_dangerous_later(tmp_path, plan, field, value):
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(json.loads(plan) | {field: value}))
    with pytest.raises(PlanError):
        load_plan(file)


@pytest.mark.parametrize("load", [load_plan, load_vehicle, load_commands])
def test_files_without_end_are_not_read_to_their_end(load):
    with pytest.raises(ValueError, match="larger than"):
        load(Path("/dev/zero"))


# --- commands -------------------------------------------------------------------------------------


@fuzzed
@given(content=damaged(COMMANDS))
def test_commands_bytes(tmp_path, content):
    survives(load_commands, CommandsError, tmp_path / "commands.csv", content)


# --- study ----------------------------------------------------------------------------------------


@pytest.fixture
def study(tmp_path):
    folder = tmp_path / "study"
    made = Study.create(
        folder, {"a": (0, 1)}, {"p": (0, 1), "q": (0, 1)}, "p", samples=8, budget=400
    )
    made.ask()
    return folder


@pytest.mark.slow
@fuzzed
@given(data=st.data())
def test_study_files(study, data):
    name = data.draw(st.sampled_from(["study.json", "points.csv", "results.csv"]))
    file = study / name
    original = file.read_bytes() if file.exists() else RESULTS
    try:
        survives(lambda _: Study.open(study), DesignError, file, data.draw(damaged(original)))
    finally:
        file.write_bytes(original)


@fuzzed
@given(data=st.data())
def test_study_document(study, data):
    file = study / "study.json"
    original = file.read_bytes()
    content = json.dumps(data.draw(changed(json.loads(original)))).encode()
    try:
        survives(lambda _: Study.open(study), DesignError, file, content)
    finally:
        file.write_bytes(original)


@fuzzed
@given(content=damaged(RESULTS))
def test_told_results(study, tmp_path, content):
    survives(Study.open(study).tell_csv, DesignError, tmp_path / "told.csv", content)


def test_a_study_of_too_many_samples_is_refused_before_they_are_drawn(study):
    file = study / "study.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"samples": 10**12}))
    with pytest.raises(DesignError, match="samples must be"):
        Study.open(study)


# --- bag ------------------------------------------------------------------------------------------


def read_bag(path):
    with BagReader(path) as bag:
        for message in bag.messages():
            try:
                deserialize(bag.topics[message.topic].type, message.data)
            except BagError:
                continue


def strings(n):
    store = jazzy()
    kind = store.types["std_msgs/msg/String"]
    return [bytes(store.serialize_cdr(kind(str(i) * 9), kind.__msgtype__)) for i in range(n)]


@pytest.fixture(scope="module")
def mcap(tmp_path_factory):
    contents = []
    for compression in Compression:
        folder = tmp_path_factory.mktemp("mcap") / "bag"
        bag = BagWriter(folder, compression=compression)
        topic = bag.add_topic(Topic.of_type("/text", "std_msgs/msg/String"))
        for stamp, data in enumerate(strings(20)):
            bag.write(topic, stamp, data)
        bag.close()
        (file,) = folder.glob("*.mcap")
        contents.append(file.read_bytes())
    return contents


@pytest.fixture(scope="module")
def sqlite(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sqlite") / "bag"
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        text = writer.add_connection("/text", "std_msgs/msg/String", typestore=jazzy())
        for stamp, data in enumerate(strings(5)):
            writer.write(text, stamp, data)
    return folder


@pytest.mark.slow
@fuzzed
@given(data=st.data())
def test_mcap_bytes(tmp_path, mcap, data):
    content = data.draw(damaged(data.draw(st.sampled_from(mcap))))
    survives(read_bag, BagError, tmp_path / "bag.mcap", content)


@pytest.mark.slow
@fuzzed
@given(data=st.data())
def test_sqlite_bytes(tmp_path, sqlite, data):
    (file,) = sqlite.glob("*.db3")
    survives(read_bag, BagError, tmp_path / "bag.db3", data.draw(damaged(file.read_bytes())))


@pytest.mark.slow
@fuzzed
@given(data=st.data())
def test_bag_metadata(sqlite, data):
    file = sqlite / "metadata.yaml"
    original = file.read_bytes()
    document = changed(yaml.safe_load(original)).map(lambda d: yaml.safe_dump(d).encode())
    try:
        survives(
            lambda _: read_bag(sqlite), BagError, file, data.draw(document | damaged(original))
        )
    finally:
        file.write_bytes(original)


@pytest.mark.parametrize("name", ["../other.db3", "/etc/passwd", "inner/../../x.db3", ".."])
def test_a_bag_reads_no_file_outside_of_it(sqlite, name):
    file = sqlite / "metadata.yaml"
    original = file.read_text()
    document = yaml.safe_load(original)
    document["rosbag2_bagfile_information"]["relative_file_paths"] = [name]
    file.write_text(yaml.safe_dump(document))
    try:
        with pytest.raises(BagError, match="outside of the bag"):
            BagReader(sqlite)
    finally:
        file.write_text(original)


def test_a_chunk_that_says_it_is_enormous_is_damaged(tmp_path, mcap):
    content = bytearray(mcap[0])
    chunk = content.index(b"\x06", 8)  # opcode of the chunk; its uncompressed size follows
    while struct.unpack_from("<Q", content, chunk + 1)[0] > len(content):
        chunk = content.index(b"\x06", chunk + 1)
    struct.pack_into("<Q", content, chunk + 9 + 16, 2**40)
    (tmp_path / "bag.mcap").write_bytes(content)
    with pytest.raises(BagError, match="beyond the limit"):
        read_bag(tmp_path / "bag.mcap")


@pytest.mark.parametrize("name", ["os/path/x", "os.path/msg/join", "../x/msg/y", "", "a/msg/b/c"])
def test_the_type_of_a_topic_is_neither_imported_nor_a_path_unless_it_is_a_type(name):
    for use in (message_class, lambda n: Topic.of_type("/topic", n)):
        with pytest.raises(BagError, match="is not a message type"):
            use(name)
