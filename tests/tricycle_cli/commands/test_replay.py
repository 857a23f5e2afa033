"""`tricycle replay`: mistakes are found before anything is started."""

import pytest

from tricycle_core.errors import BagError


@pytest.mark.parametrize(
    ("arguments", "error", "reason"),
    [
        (("replay", "nowhere"), BagError, "no such bag"),
        (
            ("replay", "{bag}", "--remap", "/chater:=/x"),
            BagError,
            r"--remap /chater:=/x: no topic of the bag is /chater; did you mean /chatter\?$",
        ),
    ],
)
def test_mistakes(tricycle, bag, arguments, error, reason):
    with pytest.raises(error, match=reason):
        tricycle(*(argument.format(bag=bag) for argument in arguments))


@pytest.mark.parametrize(
    "arguments",
    [
        ("replay", "bag", "--rate", "nan"),
        ("replay", "bag", "--remap", "odom=x"),
        ("replay", "bag", "--duration", "0"),
        ("bag", "convert", "bag", "--output", "new", "--duration", "0"),
    ],
)
def test_mistyped_options_are_argparses(tricycle, arguments, capsys):
    with pytest.raises(SystemExit) as status:
        tricycle(*arguments)
    assert status.value.code == 2
    assert capsys.readouterr().err


@pytest.mark.parametrize("whole", [True, False])
def test_a_bag_that_was_cut_off_is_played_and_said_to_be(tricycle, bag, capsys, monkeypatch, whole):
    if not whole:
        file = bag / "bag_0.mcap"
        file.write_bytes(file.read_bytes()[:9000])
    played = {}

    def run(_node, parameters, *, remappings):
        played.update(parameters, remappings=remappings)
        return 0

    monkeypatch.setattr("tricycle_cli.commands.replay.run_in_foreground", run)
    remappings = ["/chatter:=/x", "/clock:=/y", "/bag_replayer/pause:=/z"]
    assert tricycle("replay", bag, "--remap", *remappings) == 0
    assert (f"{bag}: not whole" in capsys.readouterr().err) != whole
    assert (played["duration"], played["remappings"]) == (0.0, remappings)
    assert tricycle("replay", bag, "--duration", "2") == 0
    assert played["duration"] == 2.0
