"""Records of MCAP files (https://mcap.dev/spec), as reader and writer share them."""

import io
import struct
from collections.abc import Iterator

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.records import McapRecord

MAGIC = b"\x89MCAP0\r\n"  # first and last bytes of a file
METADATA_RECORD = "tricycle"  # name of the metadata record: plan id, vehicle hash, versions
LOST, FAILURE = "lost", "failure"  # in it: which messages a bag lacks, why it was ended

RECORD = struct.Struct("<BQ")  # head of every record: opcode, length of its content
MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; the data follow
CHUNK = struct.Struct("<QQQII")  # start, end, uncompressed size, CRC, length of compression name
MESSAGE_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of entries, which follow
INDEX_ENTRY = struct.Struct("<QQ")  # log time, offset in the uncompressed chunk
FOOTER_SIZE = RECORD.size + 20 + len(MAGIC)

Buffer = bytes | memoryview


def serialize(*records: McapRecord) -> bytes:
    """Return records with their heads, one behind the other."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def stream(content: Buffer) -> ReadDataStream:
    """Return the content of a record as `mcap.records` reads it.

    Parameters
    ----------
    content : bytes or memoryview
        Content without the head.
    """
    return ReadDataStream(io.BytesIO(content))


def split_records(data: Buffer) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and length of the content of each record.

    Parameters
    ----------
    data : bytes or memoryview
        Whole records, one behind the other.

    Raises
    ------
    struct.error
        If the last one is cut off.
    """
    offset, size = 0, len(data)
    while offset < size:
        opcode, length = RECORD.unpack_from(data, offset)
        offset += RECORD.size
        if offset + length > size:
            raise struct.error(f"record of {length} bytes ends beyond its chunk")
        yield opcode, offset, length
        offset += length
