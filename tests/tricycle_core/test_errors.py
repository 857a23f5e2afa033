"""One tree of exceptions, drawn where it is defined."""

import inspect
import re

from tricycle_core import errors


def classes():
    found = inspect.getmembers(errors, inspect.isclass)
    return {name: kind for name, kind in found if kind.__module__ == errors.__name__}


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


def test_a_hint_names_the_closest_name_or_as_many_as_fit_a_line():
    many = [f"variable_{i}" for i in range(1000)]
    assert errors.hint("variabel_7", many) == "did you mean variable_7?"
    listed = errors.hint("x", many)
    assert listed.startswith("there are: variable_0, ")
    assert listed.endswith(", …")
    assert len(listed) < errors.CUT + 20
    assert len(errors.hint("x", ["y" * 10_000])) < errors.CUT + 20
