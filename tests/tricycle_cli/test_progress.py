import logging
from contextlib import suppress

import pytest

from tricycle_cli.main import main
from tricycle_cli.progress import progress_bar


@pytest.mark.parametrize("fails", [True, False])
def test_a_bar_is_wiped_where_its_work_fails(fails, capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes it for a terminal
    monkeypatch.setenv("TERM", "xterm")
    with suppress(ZeroDivisionError), progress_bar("working") as report:
        report(1, 2)
        _ = 1 / (not fails)
    shown = capsys.readouterr().err
    assert "working" in shown
    assert ("1/2" if fails else "1/1") in shown  # done, though it might have taken more
    assert shown.endswith("\x1b[1A\x1b[2K") == fails


def test_nothing_is_shown_where_work_fails_and_no_terminal_can_wipe_it(capsys):
    with suppress(ZeroDivisionError), progress_bar("working") as report:
        report(1, 2)
        _ = 1 / 0
    assert capsys.readouterr().err == ""


def test_what_is_logged_has_a_line_of_its_own_above_the_bar(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(logging.root, "handlers", [])
    assert main(["judge", "no-bag"]) == 2  # sets the logging up
    capsys.readouterr()
    with progress_bar("working"):
        logging.getLogger("tricycle_sim").warning("compiling")
    assert "\x1b[2Kcompiling\n" in capsys.readouterr().err


def test_a_long_description_leaves_room_for_count_and_times(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with progress_bar("planning double_lane_change for camber_stiffness") as report:
        report(12_406, 12_406)
    shown = capsys.readouterr().err
    assert "planning double_lane_change for camber" in shown
    assert "12406/12406 0:00:00 left 0:00:00" in shown
