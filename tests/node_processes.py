"""The processes of a test's nodes, found by the folder in which they log."""

from pathlib import Path


def node_processes(folder: Path, name: str = "") -> list[int]:
    """Numbers of the processes of a name whose environment names something in a folder."""
    found = []
    for process in Path("/proc").iterdir():
        try:
            where, what = ((process / file).read_text() for file in ("environ", "cmdline"))
        except OSError:  # no process, or one that has ended
            continue
        if f"{folder}/" in where and name in what:
            found.append(int(process.name))
    return found
