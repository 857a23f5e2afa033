"""The documentation builds without a warning, is fresh, and its commands and code run."""

import ast
import importlib
import importlib.util
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PACKAGES = {path.name for path in (ROOT / "src").iterdir()}
GENERATE = """
import json, sys, generate_reference
print(json.dumps({page: generate_reference.PAGES[page]() for page in sys.argv[1:]}))
"""


def blocks(page, language):
    """Fenced blocks of a page, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```$", (DOCS / page).read_text(), re.M | re.S)


def generator():
    specification = importlib.util.spec_from_file_location(
        "generate_reference", DOCS / "generate_reference.py"
    )
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_a_broken_link_fails_the_build_as_the_makefile_starts_it(tmp_path):
    (line,) = re.findall(r"mkdocs build.*", (ROOT / "Makefile").read_text())
    plain = re.sub(
        r"(?s)plugins:.*?(?=exclude_docs)|nav:\n.*", "", (ROOT / "mkdocs.yml").read_text()
    )
    (tmp_path / "mkdocs.yml").write_text(re.sub(r"extra(_\w+)?:.*\n( .*\n)?", "", plain))
    (tmp_path / "docs").mkdir()
    status = {}
    for page in ("[there](index.md)", "[nowhere](missing.md)", "[there](index.md#missing)"):
        (tmp_path / "docs" / "index.md").write_text(f"# Page\n\n{page}\n")
        done = subprocess.run(
            [sys.executable, "-m", *shlex.split(line)],
            cwd=tmp_path, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, capture_output=True,
        )  # fmt: skip
        status[page] = done.returncode
    assert list(status.values()) == [0, 1, 1], status


@pytest.mark.slow  # one test: two would be shared out, and the site built by each process
def test_the_site_builds_without_a_warning_and_works_from_a_folder_without_a_network(tmp_path):
    """The site's own scripts only; the search index is a script, which a page may load."""
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", tmp_path],
        cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "index.html").exists()
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("it builds; no Chromium on PATH (Debian: apt-get install chromium)")
    sync_api = pytest.importorskip("playwright.sync_api")
    requests = []
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page()
        page.on("request", lambda request: requests.append(request.url))
        page.goto((tmp_path / "method.html").as_uri())
        page.wait_for_selector(".arithmatex .katex-html")
        page.fill("input[name=query]", "watchdog")
        page.wait_for_selector(".md-search-result__item")
        browser.close()
    assert {url.partition(":")[0] for url in requests} <= {"file", "data", "blob", "about"}


def test_the_first_page_leads_to_every_other():
    linked = set(re.findall(r"\]\(([\w-]+\.md)\)", (DOCS / "index.md").read_text()))
    assert {page.name for page in DOCS.glob("*.md")} - linked == {"index.md"}


def test_every_package_has_a_page_of_its_interface():
    assert {page.stem for page in (DOCS / "api").glob("*.md")} == PACKAGES
    for package in PACKAGES:
        assert (DOCS / "api" / f"{package}.md").read_text() == f"::: {package}\n"


@pytest.mark.parametrize(
    "page", ["architecture.md", "link.md", "model.md", "method.md", "../CONTRIBUTING.md"]
)
def test_source_files_that_pages_name_exist(page):
    named = re.findall(r"`(\w+/(?:[\w./]*/|[\w./]*\.\w+|))`", (DOCS / page).read_text())
    assert named

    def exists(path):
        package = path.split("/")[0]
        return (ROOT / "src" / package / path if package in PACKAGES else ROOT / path).exists()

    assert [path for path in named if not exists(path)] == []


def test_the_page_of_the_architecture_names_every_node():
    page = (DOCS / "architecture.md").read_text()
    started = re.compile(r'start\("(\w+)\.(\w+)"\)')
    modules = [
        f"{package}/{module}.py"
        for path in (ROOT / "src").glob("*/*/executables.py")
        for package, module in started.findall(path.read_text())
    ]
    assert len(modules) >= 7
    assert [module for module in modules if f"`{module}`" not in page] == []


def own_imports(code):
    """(module, name) of what a piece of Python imports from the packages."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] in PACKAGES:
            yield from ((node.module, alias.name) for alias in node.names)


SHOWN = {page.name: "\n".join(blocks(page.name, "python")) for page in sorted(DOCS.glob("*.md"))}
BENCHMARKS = {f"benchmarks/{p.name}": p.read_text() for p in (ROOT / "benchmarks").glob("*.py")}


@pytest.mark.parametrize(
    "where", [name for name, code in (SHOWN | BENCHMARKS).items() if any(own_imports(code))]
)
def test_imports_of_pages_and_benchmarks_work(where):
    for module, name in own_imports((SHOWN | BENCHMARKS)[where]):
        if not hasattr(importlib.import_module(module), name):
            importlib.import_module(f"{module}.{name}")


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["search.py", "--only", "nosuch"], "--only: no such case; there are: Eq. 13 p1"),
        (["sets.py", "--criterion", "h"], "invalid choice: 'h'"),
        (["clusters.py", "dask"], "SCHEDULER is not set"),
    ],
)
def test_benchmarks_tell_a_mistake_in_a_line(command, said):
    command = [sys.executable, ROOT / "benchmarks" / command[0], *command[1:]]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode in (1, 2)
    assert said in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


def assert_fresh(*pages):
    # in a process of its own: what it sets must not reach this one, nor the other way round
    done = subprocess.run(
        [sys.executable, "-c", GENERATE, *pages],
        cwd=DOCS, capture_output=True, text=True, check=True,
    )  # fmt: skip
    for page, text in json.loads(done.stdout).items():
        assert text == (DOCS / page).read_text(), f"{page} is stale: run `make reference`"


@pytest.mark.slow
def test_generated_pages_are_fresh():
    assert_fresh("reference-commands.md", "protocol.md", "reference-files.md")


@pytest.mark.ros
def test_the_generated_page_of_the_nodes_is_fresh():
    assert_fresh("reference-nodes.md", "../src/tricycle_core/tricycle_core/nodes.json")


def test_a_field_without_a_description_is_told():
    undescribed = generator().dataclasses.make_dataclass("Undescribed", ["speed"])
    with pytest.raises(SystemExit, match="Undescribed: its docstring misses speed"):
        generator()._fields(undescribed)


@pytest.mark.slow
def test_python_of_the_simulator_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code = "\n".join(blocks("how-to-simulator.md", "python"))
    names = {}
    exec(compile(code, "how-to-simulator.md", "exec"), names)
    assert names["design"].x == pytest.approx(names["study"].design().x)


def run_commands(page, folder):
    """Run the page's commands one after the other, as a reader would type them."""
    search = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    commands = [line for block in blocks(page, "sh") for line in block.splitlines() if line]
    for command in commands:
        done = subprocess.run(
            ["bash", "-c", command], cwd=folder, env=os.environ | {"PATH": search},
            capture_output=True, text=True,
        )  # fmt: skip
        assert done.returncode == 0, f"{command}: {done.stderr[-2000:]}"
    return commands


@pytest.mark.slow
def test_commands_of_the_vehicle_page_run(tmp_path):
    run_commands("how-to-vehicle.md", tmp_path)
    assert (tmp_path / "circle.csv").exists()


@pytest.mark.slow
@pytest.mark.ros
def test_commands_of_the_tutorial_run(tmp_path):
    commands = run_commands("tutorial.md", tmp_path)
    verbs = {shlex.split(command)[1] for command in commands}
    assert verbs >= {"plan", "drive", "bag", "judge", "identify", "report"}
    assert (tmp_path / "tutorial" / "report.html").exists()
    assert (tmp_path / "tutorial" / "judgement.png").exists()
