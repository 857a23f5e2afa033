"""Records of MCAP files against the library of the format."""

import io
import struct

import pytest
from mcap.opcode import Opcode
from mcap.records import Metadata
from mcap.stream_reader import StreamReader

from trajectory_recorder.bag.records import MAGIC, RECORD, serialize, split_records, stream

RECORDS = [Metadata(name="a", metadata={"key": "value"}), Metadata(name="b", metadata={})]


def test_what_is_encoded_is_split_and_read_again():
    data = serialize(*RECORDS)
    found = list(split_records(data))
    assert [opcode for opcode, _, _ in found] == [Opcode.METADATA, Opcode.METADATA]
    contents = [data[start : start + length] for _, start, length in found]
    assert [Metadata.read(stream(content)) for content in contents] == RECORDS
    library = StreamReader(io.BytesIO(MAGIC + data), skip_magic=False)
    records = library.records
    assert [next(records), next(records)] == RECORDS


def test_a_record_that_is_cut_off_is_refused():
    data = serialize(*RECORDS)
    with pytest.raises(struct.error, match="ends beyond its chunk"):
        list(split_records(data[:-1]))
    with pytest.raises(struct.error):
        list(split_records(data + data[: RECORD.size - 1]))
