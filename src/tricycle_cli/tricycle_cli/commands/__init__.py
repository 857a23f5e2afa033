"""The subcommands of `tricycle`, one module each, with `add_arguments(parser)` and `run(args)`.

A module imports what its arguments need. What the work needs is imported by `run`, so that help
and a wrong argument are answered at once.
"""
