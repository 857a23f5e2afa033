"""The notebooks of the gallery run as they stand and draw their figure."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

GALLERY = Path(__file__).parents[1] / "docs" / "gallery"


@pytest.mark.slow
@pytest.mark.parametrize("notebook", sorted(GALLERY.glob("*.py")), ids=lambda path: path.stem)
def test_a_notebook_runs(notebook, tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "error", notebook],
        cwd=tmp_path, env=os.environ | {"MPLBACKEND": "Agg"}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout
    assert (tmp_path / f"{notebook.stem}.png").stat().st_size > 5000


def test_every_notebook_is_on_the_page_with_its_figure():
    page = (GALLERY.parent / "gallery.md").read_text()
    for notebook in GALLERY.glob("*.py"):
        assert f'--8<-- "docs/gallery/{notebook.name}"' in page
        assert f"](gallery/{notebook.stem}.png)" in page
        assert notebook.with_suffix(".png").exists()
