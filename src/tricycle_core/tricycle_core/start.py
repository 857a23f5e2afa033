"""Start of the nodes' executables, before anything else is imported."""

import shutil
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


def ending_with_parent() -> list[str]:
    """Return what to put before a node's command, so that it ends when its parent is killed.

    Without setpriv (util-linux) that is nothing.
    """
    guard = shutil.which("setpriv")
    return [guard, "--pdeathsig", "TERM"] if guard else []


def ending_signals() -> list[signal.Signals]:
    """Return the signals that end a process in order.

    That of Ctrl-C, a service manager's, and that of a lost terminal unless nohup is to outlive it.
    """
    outlives = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM, *([] if outlives else [signal.SIGHUP])]
