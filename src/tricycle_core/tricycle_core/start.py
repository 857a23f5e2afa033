"""Start of the nodes' executables, before anything else is imported."""

import signal
from importlib import import_module


def start(module: str) -> None:
    """Import a node's module and run its `main`; Ctrl-C meanwhile ends the process silently.

    Parameters
    ----------
    module : str
        Name of the module.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # until `run_node` handles it
    import_module(module).main()
