"""Patterns stand for the bags that they match."""

from pathlib import Path

import pytest

from trajectory_recorder.bag.location import bag_path, find_bags, scheme_of
from tricycle_core.errors import BagError


@pytest.fixture
def bags(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("one/first", "one/second", "two/torn"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("one/first", "one/second"):
        (tmp_path / name / "metadata.yaml").touch()
        (tmp_path / name / "part_0.mcap").touch()
    (tmp_path / "two/torn/torn_0.mcap").touch()
    (tmp_path / "two/alone.db3").touch()
    (tmp_path / "two/notes.txt").touch()


@pytest.mark.parametrize(
    ("pattern", "found"),
    [
        ("**", ["one/first", "one/second", "two/alone.db3", "two/torn"]),
        ("one/*", ["one/first", "one/second"]),
        ("**/*.mcap", ["one/first", "one/second", "two/torn"]),
        ("two/[a-m]*", ["two/alone.db3"]),
        ("nowhere/bag", ["nowhere/bag"]),  # a path is what it is
    ],
)
def test_a_pattern_stands_for_bags(bags, pattern, found):
    assert [bag.as_posix() for bag in find_bags(pattern)] == found


@pytest.mark.parametrize(
    ("location", "scheme"),
    [
        ("S3://bags/one", "s3"),
        (Path("s3://bags/one"), "s3"),
        ("s3:/bags/one", ""),
        ("c:/one", ""),
        (Path("bags/one"), ""),
    ],
)
def test_a_url_is_known_also_where_it_was_a_path(location, scheme):
    assert scheme_of(location) == scheme


def test_a_path_with_the_characters_of_a_pattern_is_a_path(bags, tmp_path):
    (tmp_path / "one[1]").mkdir()
    assert [bag.name for bag in find_bags("one[1]")] == ["one[1]"]


def test_a_bag_without_metadata_is_known_by_its_files_whatever_its_name(bags, tmp_path):
    (tmp_path / "two/torn[1]").mkdir()
    (tmp_path / "two/torn[1]/torn[1]_0.mcap").touch()
    assert [bag.name for bag in find_bags("two/torn*")] == ["torn", "torn[1]"]


@pytest.mark.parametrize(
    "secret",
    [
        "sftp://me:sec*ret@host/bag",
        "https://sec*ret@host/bag",
        "https://host/bag?sig=sec*ret",
        "s3://bucket/bag?X-Amz-Signature=sec*ret",
        "az://container/bag?sv=2022&sig=secret",
    ],
)
def test_a_secret_is_refused_and_not_repeated_in_a_pattern_either(secret):
    with pytest.raises(BagError, match="which results would show") as caught:
        find_bags(secret)
    assert "ret" not in str(caught.value).partition("which")[0]


def test_an_at_sign_behind_a_port_is_no_password():
    assert str(bag_path("http://host:8000/run@noon")) == "http://host:8000/run@noon"


@pytest.mark.parametrize("pattern", ["two/*.txt", "one/x*", "https://example.org/bags/*"])
def test_a_pattern_without_bags_is_an_error(bags, pattern):
    with pytest.raises(BagError, match=r"matches no bag|patterns are those of files"):
        find_bags(pattern)
