"""Benchmarks as modules, whose single cases tests look at."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "benchmarks"


def load_benchmark(name):
    """The benchmark of that name, which imports no other one."""
    spec = spec_from_file_location(f"{name}_benchmark", FOLDER / f"{name}.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
