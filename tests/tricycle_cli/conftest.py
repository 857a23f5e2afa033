"""The command line as a user types it."""

import pytest

from tricycle_cli.main import parser


@pytest.fixture
def tricycle():
    """Run a subcommand with these arguments; mistakes are raised, as `main` catches them."""

    def run(*arguments):
        words = [str(argument) for argument in arguments]
        args = parser(words[:1]).parse_args(words)
        return args.run(args)

    return run
