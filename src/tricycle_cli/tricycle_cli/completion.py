"""Completion of commands and options by the shell: `tricycle --completion bash`."""

import argparse
import textwrap
from collections.abc import Mapping, Sequence

SHELLS = ("bash", "zsh")

_SCRIPT = """\
# eval "$(tricycle --completion {shell})"
{load}_tricycle() {{
    local words
    case "${{COMP_WORDS[1]}}" in
{cases}
        *) words="{commands}" ;;
    esac
    if [ "$COMP_CWORD" -eq 1 ]; then words="{commands}"; fi
    COMPREPLY=($(compgen -W "$words" -- "${{COMP_WORDS[COMP_CWORD]}}"))
}}
complete -o default -F _tricycle tricycle
"""


def completion_script(shell: str, words: Mapping[str, Sequence[str]]) -> str:
    """Return what a shell evaluates to complete words; files where no word fits.

    Parameters
    ----------
    shell : str
        One of `SHELLS`.
    words : mapping of str to sequence of str
        Words that may follow each command.
    """
    cases = "\n".join(
        f'        {name}) words="{" ".join(follow)}" ;;' for name, follow in words.items()
    )
    load = "autoload -U +X bashcompinit && bashcompinit\n" if shell == "zsh" else ""
    return _SCRIPT.format(shell=shell, load=load, cases=cases, commands=" ".join(words))


def words_of(parser: argparse.ArgumentParser) -> list[str]:
    """Return what may follow a command: its subcommands, its options and their choices.

    Parameters
    ----------
    parser : ArgumentParser
        Parser of the command.
    """
    words: set[str] = set()
    for action in parser._actions:  # noqa: SLF001  (argparse tells its options by this only)
        words.update(action.option_strings)
        words.update(map(str, action.choices or ()))
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for inner in action.choices.values():
                words.update(words_of(inner))
    return sorted(words)


class HelpFormatter(argparse.RawDescriptionHelpFormatter):
    """Help with the default of every option that has one; it keeps the lines of examples."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if "\n" in text:
            return super()._fill_text(text, width, indent)
        return textwrap.fill(text, width, initial_indent=indent, subsequent_indent=indent)

    def _get_help_string(self, action: argparse.Action) -> str | None:
        text = action.help or ""
        default = action.default
        none = default is None or default is False or default in ("", [], argparse.SUPPRESS)
        if none or "default" in text or not action.option_strings:
            return action.help
        return f"{text} (default: %(default)s)".strip()
