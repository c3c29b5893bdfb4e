"""What is said of an error of a plug-in: the error itself, in a line, and where it was."""

import numpy as np
import pytest

from meanflock.swarm.plugins.failures import last_line, reason


def noted(error: Exception) -> Exception:
    error.add_note("while something was tried")
    return error


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (ValueError("no such table"), "ValueError: no such table"),
        (ValueError("one line\n\n  and another\n"), "ValueError: one line and another"),
        (noted(ValueError("no such table")), "ValueError: no such table"),
        (ValueError(), "ValueError"),
        (KeyError("weights"), "KeyError: 'weights'"),
        (SystemExit(3), "SystemExit: 3"),
        (np.linalg.LinAlgError("Singular matrix"), "numpy.linalg.LinAlgError: Singular matrix"),
        (SyntaxError("invalid syntax", ("mine.py", 3, 1, "x = = 3")), "SyntaxError: invalid syntax"),
    ],
)
def test_the_error_is_said_in_a_line_whatever_was_added_to_it(error: BaseException, says: str) -> None:
    assert reason(error) == says


def test_the_line_of_an_error_with_a_note_is_said_too() -> None:
    with pytest.raises(ValueError, match="no such") as caught:
        raise noted(ValueError("no such\ntable"))
    line = caught.traceback[0].lineno + 1
    assert last_line(caught.value) == f"ValueError: no such table (test_failures.py, line {line})"
