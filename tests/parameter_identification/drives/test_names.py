"""Names by which results tell drives apart."""

from pathlib import Path

import pytest

from parameter_identification.drives.names import name_of, names_of


@pytest.mark.parametrize(
    ("bag", "name"),
    [
        ("out/drive.1", "drive.1"),
        ("out/drive_0.mcap", "drive_0"),
        ("out/drive_0.db3", "drive_0"),
        ("out/drive_0.mcap.zstd", "drive_0.mcap"),
    ],
)
def test_only_files_lose_their_suffix(bag, name):
    assert name_of(Path(bag)) == name


def test_as_many_folders_as_needed_tell_bags_apart():
    assert names_of([Path("a/drive.1"), Path("a/drive.2")]) == ["drive.1", "drive.2"]
    assert names_of([Path("a/bag"), Path("b/bag")]) == ["a/bag", "b/bag"]
    both = names_of([Path("a/bag.mcap"), Path("a/bag.db3")])
    assert both == ["a/bag", "a/bag (2)"]
