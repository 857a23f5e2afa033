"""Reports: what is in the files is on the page, and the page works in a browser that is offline."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest

from excitation_planner.plan import load_plan, save_plan
from tricycle_cli.main import main
from tricycle_cli.reports.figure_files import figures_by_file, write_figures
from tricycle_cli.reports.html_page import PlotBlock, Section
from tricycle_cli.reports.run_folder import Maneuver, Run, read_run, wheel_loads
from tricycle_cli.reports.run_page import run_page, run_sections
from tricycle_sim.vehicle import load_vehicle

VEHICLE = load_vehicle()
HOSTILE = "</script><img src=x onerror=alert(1)>"


@pytest.mark.slow
def test_the_table_says_what_was_measured(folder):
    page = run_page(read_run(folder), vehicle=VEHICLE)
    table = page.partition("<h2>Results</h2>")[2].partition("</table>")[0]
    for text in ("designed", "radius 3, speed 0.8", "0.00123", "50.0"):
        assert f">{text}<" in table


@pytest.mark.parametrize("text", ["[1]", '{"score": {"x": 1}}', "["])
def test_the_result_of_another_program_is_left_out(text, identified, tmp_path):
    (tmp_path / "result.json").write_text(text)
    (tmp_path / "identification.json").write_text(json.dumps(identified))
    assert "Not shown, as it is not of tricycle demo" in run_page(
        read_run(tmp_path), vehicle=VEHICLE
    )


def test_a_bag_that_cannot_be_judged_is_shown_with_its_reason(record_drive, tmp_path):
    record_drive(tmp_path / "bag", end="aborted")
    (maneuver,) = read_run(tmp_path).maneuvers
    assert "aborted" in maneuver.failure
    assert "Not judged" in run_page(read_run(tmp_path), vehicle=VEHICLE)


@pytest.mark.slow
def test_loads_carry_the_vehicle_and_belong_to_the_plans_vehicle(plan):
    loads = wheel_loads(VEHICLE, plan)
    carried = sum(loads.by_wheel.values())
    assert np.mean(carried) == pytest.approx(VEHICLE.mass * VEHICLE.gravity, rel=1e-3)
    other = dataclasses.replace(plan, vehicle_hash="0" * 64)
    run = Run(Path("run"), (Maneuver("other", other),))
    assert "No wheel loads" in run_page(run, vehicle=VEHICLE)


@pytest.mark.slow
def test_an_identification_is_shown_with_its_profiles(identified, tmp_path):
    (tmp_path / "identification.json").write_text(json.dumps(identified))
    page = run_page(read_run(tmp_path), vehicle=VEHICLE)
    for text in ("610", "590 … 640", "600 ✓", "not shown"):
        assert f">{text}</td>" in page
    assert 'class="miss"' not in page
    identified["parameters"]["cornering_stiffness"]["truth"] = 700.0
    (tmp_path / "identification.json").write_text(json.dumps(identified))
    assert 'class="miss">700 ✗</td>' in run_page(read_run(tmp_path), vehicle=VEHICLE)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["svg", "pdf"])
def test_every_figure_is_a_file_on_demand(folder, tmp_path, suffix):
    sections = run_sections(read_run(folder), vehicle=VEHICLE)
    files = write_figures(sections, tmp_path / "figures", suffix)
    assert {f.name for f in files} >= {
        f"designed_{n}.{suffix}" for n in ("trajectories", "error", "commands", "indices")
    }
    begin = {"svg": b"<?xml", "pdf": b"%PDF"}[suffix]
    assert all(file.read_bytes().startswith(begin) for file in files)


def test_figures_of_drives_whose_names_look_alike_are_files_of_their_own(tmp_path):
    section = Section("", (PlotBlock("error", (go.Figure(),), ""),))
    titles = ["a b", "a_b", "run 10:00", "run 10:30", "run: circle for mass", "n" * 300]
    sections = [dataclasses.replace(section, title=title) for title in titles]
    files = [file.name for file in figures_by_file(sections, tmp_path, "svg")]
    assert files[:2] == ["a_b_error.svg", "a_b_error-2.svg"]
    assert files[2:5] == [f"run{at}_error.svg" for at in ("_10_00", "_10_30", "")]
    assert len(files) == len(titles)
    assert max(map(len, files)) < 100


@pytest.mark.slow
def test_a_browser_shows_it_offline_without_a_complaint(folder, plan, tmp_path):
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium on PATH (Debian: apt-get install chromium)")
    sync_api = pytest.importorskip("playwright.sync_api")
    file = folder / "plans" / "designed.json"
    hostile = dataclasses.replace(
        plan, maneuver=HOSTILE, operation={HOSTILE: 3.0, "speed": 0.8}, verdict=HOSTILE
    )
    save_plan(hostile, file)
    assert load_plan(file).maneuver == HOSTILE
    assert main(["report", str(folder)]) == 0
    complaints, requests = [], []
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        grounds = {}
        for scheme in ("light", "dark"):
            page = browser.new_page(color_scheme=scheme)
            page.on("console", lambda message: complaints.append(message.text))
            page.on("pageerror", lambda error: complaints.append(str(error)))
            page.on("request", lambda request: requests.append(request.url))
            page.context.set_offline(True)
            page.goto((folder / "report.html").as_uri())
            page.wait_for_function("window.Plotly")
            page.evaluate("plots.forEach(draw)")
            page.wait_for_function(
                "[...document.querySelectorAll('.plot')].every(p => p.querySelector('.main-svg'))"
            )
            drawn = page.locator(".plot .xtitle").all_text_contents()
            grounds[scheme] = page.evaluate("getComputedStyle(document.body).backgroundColor")
            texts = page.locator(".plot text.xtitle").first
            grounds[scheme, "text"] = texts.evaluate("text => getComputedStyle(text).fill")
        width = page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
        page.pdf(path=tmp_path / "report.pdf", format="A4")
        browser.close()
    assert complaints == []
    schemes = {url.partition(":")[0] for url in requests}
    assert schemes <= {"file", "data", "blob"}  # a blob is of the page itself
    assert {"x / m", "time since the start / s", "share of the variance of TE"} <= set(drawn)
    assert HOSTILE in drawn  # as text, not as an element
    assert grounds["light"] == "rgb(255, 255, 255)"
    assert grounds["light", "text"] == "rgb(27, 27, 27)"
    assert grounds["dark"] == "rgb(22, 24, 27)"
    assert grounds["dark", "text"] == "rgb(232, 232, 232)"
    assert width
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")
