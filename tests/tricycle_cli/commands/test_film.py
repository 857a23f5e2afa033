"""`tricycle film`: recorded drives as a GIF."""

import pytest
from driven_bags import Scene, sideways
from PIL import Image


@pytest.mark.slow
def test_two_drives_move_side_by_side(tricycle, tmp_path):
    bags = [
        Scene(deviation=sideways(d), duration=6.0).write(tmp_path / f"bag{d}") for d in (0.1, 0.5)
    ]
    film = tmp_path / "films" / "film.gif"
    tricycle("film", *map(str, bags), "--output", str(film), "--speed", "10")
    with Image.open(film) as image:
        assert image.n_frames == 7  # from 0 to 6 s
        assert image.width > 1.5 * image.height
        image.seek(3)
        assert len(image.convert("RGB").getcolors()) > 50


@pytest.mark.parametrize(
    "arguments", [("film", "bag", "--output", "film.mp4"), ("film", "bag", "--speed", "0")]
)
def test_mistyped_options_are_argparses(tricycle, arguments, capsys):
    with pytest.raises(SystemExit):
        tricycle(*arguments)
    assert "film" in capsys.readouterr().err
