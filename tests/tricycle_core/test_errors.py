"""One tree of exceptions, drawn where it is defined."""

import inspect
import re

from tricycle_core import errors


def classes():
    return dict(inspect.getmembers(errors, inspect.isclass))


def test_the_drawn_tree_is_the_tree():
    drawn = re.findall(r"[─ ]([A-Z]\w+)", errors.__doc__)
    assert sorted(drawn) == sorted(classes())
    for name, kind in classes().items():
        if name != "InfeasibleManeuver":
            assert issubclass(kind, errors.ExcitationError)


def test_a_users_mistake_is_a_value_error_and_an_infeasible_maneuver_is_none():
    assert issubclass(errors.ExcitationError, ValueError)
    assert not issubclass(errors.InfeasibleManeuver, ValueError)


def test_a_message_of_several_lines_is_one_printable_line():
    error = ValueError("while parsing\n  a block\x1b[31m")
    assert errors.message_of(error) == "while parsing a block [31m"


def test_an_error_of_the_system_is_told_without_its_number():
    assert errors.message_of(OSError(28, "No space left on device")) == "No space left on device"
