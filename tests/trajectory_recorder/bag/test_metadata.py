"""metadata.yaml, written and read, and refused where it is none."""

import resource

import pytest
import yaml

from trajectory_recorder.bag.metadata import (
    dump_yaml,
    load_yaml,
    read_metadata,
    write_metadata,
)
from tricycle_core.errors import BagError


def test_what_is_written_is_read(tmp_path):
    write_metadata(tmp_path, {"storage_identifier": "mcap", "relative_file_paths": ["bag_0.mcap"]})
    assert [path.name for path in tmp_path.iterdir()] == ["metadata.yaml"]
    information = read_metadata(tmp_path)
    assert information["version"] == 9
    assert information["relative_file_paths"] == ["bag_0.mcap"]


def test_a_folder_that_was_removed_does_not_come_back(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_metadata(tmp_path / "gone", {})
    assert not (tmp_path / "gone").exists()


def test_a_full_disk_keeps_the_old_text_and_leaves_nothing_else(tmp_path):
    """A file size limit stands for it: the write fails half done in the same way."""
    write_metadata(tmp_path, {"message_count": 1})
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20, limit[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            write_metadata(tmp_path, {"message_count": 2, "names": "x" * 5000})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert [path.name for path in tmp_path.iterdir()] == ["metadata.yaml"]
    assert read_metadata(tmp_path)["message_count"] == 1


def test_a_bag_without_it_has_no_information(tmp_path):
    assert read_metadata(tmp_path) == {}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [", "is not a rosbag2 metadata file"),
        ("a: 1", "is not a rosbag2 metadata file"),
        ("rosbag2_bagfile_information: 3", "is not a rosbag2 metadata file"),
        ("rosbag2_bagfile_information: {relative_file_paths: [../x]}", "outside of the bag"),
        ("#" * 17_000_000, "larger than 16000000 bytes"),
    ],
)
def test_what_is_none_is_refused_in_one_line(tmp_path, text, message):
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(BagError, match=message) as caught:
        read_metadata(tmp_path)
    assert "\n" not in str(caught.value)


def test_merge_keys_are_not_expanded():
    with pytest.raises(yaml.YAMLError):
        load_yaml("a: &a {x: 1}\nb: {<<: *a}")


def test_yaml_keeps_the_order_of_keys():
    assert dump_yaml({"b": 1, "a": [True, None]}) == "b: 1\na:\n- true\n- null"
