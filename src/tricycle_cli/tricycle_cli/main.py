"""The `tricycle` command: one subcommand per step, each a module of `commands`."""

import argparse
import atexit
import gc
import io
import logging
import os
import re
import signal
import sys
from collections.abc import Collection, Sequence
from importlib import import_module
from keyword import iskeyword
from types import ModuleType
from typing import Any, NoReturn

from tricycle_cli.completion import SHELLS, HelpFormatter, completion_script, words_of
from tricycle_core import __version__
from tricycle_core.errors import ExcitationError, did_you_mean, message_of
from tricycle_core.optional import EXTRAS, missing

COMMANDS = {
    "demo": "plan a maneuver, drive it and a random one on emulated PLCs, judge, identify",
    "plan": "design the maneuvers that excite one parameter",
    "campaign": "plan, drive and identify in turns until the targets are known well enough",
    "reproduce": "the paper's tables and figures, computed again",
    "drive": "drive a plan and record it",
    "simulate": "replay commands on the 9-DOF vehicle, write its trajectory",
    "record": "record topics to a bag until Ctrl-C",
    "replay": "publish a bag's messages as they were recorded",
    "judge": "trajectory error of recorded drives, from their bags alone",
    "import": "write a table (CSV) that another system recorded as a bag",
    "identify": "estimate the unknown parameters from recorded drives",
    "fleet": "parameters of several vehicles of one kind, and which of them is odd",
    "film": "recorded drives as a film (GIF)",
    "report": "one HTML file with the table and the figures of a run",
    "monitor": "show links, maneuver and speeds of a live run",
    "bag": "what a bag holds; cut, filter and join bags, recover a damaged one",
    "vehicle": "write a vehicle file, check it, show what follows from it",
    "plc": "what is on a serial port: which PLC, its telemetry, its counters",
}
"""What each subcommand does, in the order of the help."""

PIPE_CLOSED = 128 + signal.SIGPIPE
"""Exit status where nobody reads what is printed any more, as a shell tells it of other commands.
"""


def parser(complete: Collection[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """Return the parser of the command line.

    Parameters
    ----------
    complete : collection of str
        Subcommands with their arguments; of the others only name and summary are there, and their
        modules are not imported.
    """
    top = _Parser(
        prog="tricycle",
        description="Plan, drive, record and judge excitation maneuvers of an X-by-wire tricycle.",
    )
    top.add_argument(
        "--completion",
        choices=SHELLS,
        action=_Completion,
        help='print completion of commands and options: eval "$(tricycle --completion bash)"',
    )
    top.add_argument("--version", action="version", version=__version__)
    subparsers = top.add_subparsers(metavar="COMMAND", required=True)
    for name, summary in COMMANDS.items():
        command = subparsers.add_parser(name, help=summary, formatter_class=HelpFormatter)
        if name in complete:
            _module(name).add_arguments(command)
    return top


class _Parser(argparse.ArgumentParser):
    """Says a mistake in one line, with the options that are meant perhaps."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        # -5%, -1e-3 and -1cm are values, and wrong ones are told as such
        self._negative_number_matcher = re.compile(r"-(\.?\d|inf|nan)")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Refuse what is unknown here: the parser above would not know whose options to name."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            question = did_you_mean(unknown[0].partition("=")[0], self._option_string_actions)
            self.error(f"unrecognized arguments: {' '.join(unknown)}; {question}".rstrip("; "))
        return found, unknown

    def _get_value(self, action: argparse.Action, text: str) -> Any:
        """Return the value of an argument, or refuse it in words that say what would be right."""
        kinds = {int: "a whole number", float: "a number"}
        if (kind := action.type) in kinds:
            try:
                return kind(text)
            except ValueError:
                raise argparse.ArgumentError(action, f"{text!r}: needs {kinds[kind]}") from None
        return super()._get_value(action, text)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a value that is not one of the choices, and suggest the closest one."""
        known = [str(choice) for choice in action.choices or ()]
        if str(value) not in known and (question := did_you_mean(value, known)):
            raise argparse.ArgumentError(
                action,
                f"invalid choice: {value!r}; {question} (choose from {', '.join(known)})",
            )
        super()._check_value(action, value)

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print at once, and let `main` know of a failure: argparse would pass over it."""
        print(message, end="", file=file, flush=True)

    def error(self, message: str) -> NoReturn:
        """End with one line in place of all options."""
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def _module(name: str) -> ModuleType:
    """Module of a subcommand; one that is called as a keyword has a line behind its name."""
    return import_module(f"tricycle_cli.commands.{name}{'_' if iskeyword(name) else ''}")


class _OnStderr(logging.Handler):
    """Says what is logged on the present `sys.stderr`: while a bar is shown, in a line above it."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print the record."""
        print(self.format(record), file=sys.stderr)


class _Completion(argparse.Action):
    """Prints the completion of a shell, and ends."""

    def __call__(
        self, parser: argparse.ArgumentParser, _namespace: object, shell: object, _: object = None
    ) -> None:
        words = {}
        for name in COMMANDS:
            command = argparse.ArgumentParser()
            _module(name).add_arguments(command)
            words[name] = words_of(command)
        print(completion_script(str(shell), words), end="", flush=True)
        parser.exit()


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; a user's mistake is one line on stderr and status 2.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; default: those of this process.

    Returns
    -------
    status : int
        Exit status: 0, 2 for a mistake of the user, 130 after Ctrl-C, 141 where
        nobody reads what is printed any more, or the subcommand's.
    """
    if argv is None:  # the process is ours
        _open_closed_streams()
        gc.set_threshold(50_000)  # imports make many objects, and hardly any garbage
        atexit.register(gc.freeze)  # what is left at the end need not be looked through
        for stream in (sys.stdout, sys.stderr):  # of a locale without Greek, for example
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="replace")
    words = sys.argv[1:] if argv is None else list(argv)
    logging.basicConfig(format="%(message)s", handlers=[_OnStderr()])
    logging.getLogger("tricycle_sim").setLevel(logging.INFO)  # says when it compiles the vehicle
    # these end a run as Ctrl-C does, in order: a service manager's, and that of a lost terminal
    for ends in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(ends) is not signal.SIG_IGN:  # nohup
            signal.signal(ends, signal.default_int_handler)
    try:
        return _run(words)
    except BrokenPipeError:  # `tricycle … | head`
        if argv is None:  # what is left to be written would be told as an error at the end
            for stream in filter(None, (sys.stdout, sys.stderr)):
                try:
                    stream.flush()
                except BrokenPipeError:
                    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        return PIPE_CLOSED


def _open_closed_streams() -> None:
    """Let standard streams that are closed (``>&-``) lead nowhere.

    A file that is opened later would otherwise get the number of one, and with it what compiled
    code prints.
    """
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_RDWR)
            if nowhere != number:
                os.dup2(nowhere, number)
                os.close(nowhere)
            setattr(sys, name, os.fdopen(number, mode, closefd=False))


def _run(words: Sequence[str]) -> int:
    """Run a subcommand, and say in one line what went wrong."""
    try:
        arguments = parser(COMMANDS.keys() & words).parse_args(words)
        status: int = arguments.run(arguments)
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except (KeyboardInterrupt, SystemError, RuntimeError) as error:
        # where Ctrl-C reaches compiled code, or the making of a class before Python 3.12, the
        # interpreter's own error may follow from it
        if not isinstance(error, KeyboardInterrupt) and not isinstance(
            error.__cause__, KeyboardInterrupt
        ):
            raise
        print("tricycle: interrupted", file=sys.stderr)
        return 130
    except ModuleNotFoundError as error:
        if error.name is None or (name := error.name.partition(".")[0]) not in EXTRAS:
            raise
        print(f"tricycle: {missing(name, 'this command')}", file=sys.stderr)
        return 2
    except (ExcitationError, OSError) as error:
        print(f"tricycle: {message_of(error)}", file=sys.stderr)
        return 2
    return status
