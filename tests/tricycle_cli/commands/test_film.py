"""`tricycle film`: recorded drives as a GIF."""

import itertools
import math
import os
import re
import subprocess
import sys
from ctypes.util import find_library
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from driven_bags import Scene, SimulatedBag, sideways
from PIL import Image, ImageSequence

from tricycle_bringup.configuration import bridge_settings
from tricycle_cli.reports.rendered_film import write_rendered_film
from tricycle_core.errors import PlantError
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle

TRICYCLE = Path(sys.executable).with_name("tricycle")


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


def rendered(bag, *more, **environment):
    """Render in a process of its own: MuJoCo chooses its renderer when it is first imported."""
    command = [TRICYCLE, "film", bag, "--plant", "mujoco", *more]
    env = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    return subprocess.run(
        command, env=env | environment, capture_output=True, text=True, check=False
    )


@pytest.mark.slow
def test_a_drive_is_repeated_and_rendered_without_a_screen(tmp_path):
    pytest.importorskip("mujoco")
    if find_library("EGL") is None:
        pytest.skip("no EGL: nothing renders here without a screen")
    film, bag = tmp_path / "film.gif", SimulatedBag().write(tmp_path / "bag")
    done = rendered(bag, "--output", film, "--speed", "20")
    assert done.returncode == 0, done.stderr
    assert re.search(r"the plant mujoco drives \d+ mm \(rms\) from where", done.stdout)
    with Image.open(film) as image:
        assert image.n_frames == math.ceil(16.34 / 2.0)
        frames = []
        for frame in (0, 4):
            image.seek(frame)
            frames.append(np.asarray(image.convert("RGB"), float))
    orange = [(f[..., 0] > 150) & (f[..., 2] < 90) for f in frames]  # body and measured way
    assert all(0.005 < each.mean() < 0.1 for each in orange)
    assert np.abs(frames[0] - frames[1]).mean() > 5.0  # it has moved over the squares


@pytest.mark.parametrize("speed", [0.15, 0.25, 2.0])
def test_a_repeated_drive_lasts_as_long_as_its_speed_says(tmp_path, speed):
    """Whether or not frames come between the ticks of the drive."""
    pictures = itertools.count()
    view = SimpleNamespace(
        plant=None,
        add_line=lambda *_: None,
        picture=lambda: np.full((4, 4, 3), 80 * (next(pictures) % 3), np.uint8),
    )
    line = np.linspace(0.0, 1.0, 10)
    series = SimpleNamespace(time=line, x=line, y=line, reference_x=line, reference_y=line)
    vehicle = load_vehicle()
    write_rendered_film(
        *(view, Commands([0.0, 1.2], [0.0, 0.0], [0.5, 0.0]), series, vehicle),
        *(bridge_settings(vehicle), tmp_path / "film.gif"),
        speed=speed,
        progress=lambda *_: None,
    )
    with Image.open(tmp_path / "film.gif") as film:
        lasts = sum(frame.info["duration"] for frame in ImageSequence.Iterator(film))
    assert lasts == pytest.approx(1200 / speed, abs=100)


@pytest.mark.slow
def test_without_a_renderer_it_is_one_line_and_no_film(tmp_path):
    pytest.importorskip("mujoco")
    film, bag = tmp_path / "film.gif", SimulatedBag().write(tmp_path / "bag")
    done = rendered(bag, "--output", film, MUJOCO_GL="none")
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert "nothing renders here with MUJOCO_GL=none" in line
    assert "egl, osmesa or glfw" in line
    assert not film.exists()


def test_several_bags_cannot_be_rendered_at_once(tricycle, tmp_path):
    bag = Scene().write(tmp_path / "bag")
    with pytest.raises(PlantError, match="one bag at a time, not 2"):
        tricycle("film", bag, bag, "--plant", "mujoco")
