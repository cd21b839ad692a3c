"""Cases of a test that are slow, and refusals."""

from functools import partial
from typing import Any

import pytest

from excitant.exceptions import ExcitantError

slow = partial(pytest.param, marks=pytest.mark.slow)
"""``slow(1, 2)``: these values of the parameters, in the suite of all tests."""


def refusal(match: str, call: Any, *given: Any, error: Any = ExcitantError, **more: Any) -> Any:
    """``refusal(match, call, ...)``: the error that refuses a call, of one line."""
    with pytest.raises(error, match=match) as raised:
        call(*given, **more)
    assert len(str(raised.value).splitlines()) == 1
    return raised.value


def refused(match: str, call: Any, *given: Any, **more: Any) -> str:
    """``refused(match, call, ...)``: what it says."""
    return str(refusal(match, call, *given, **more))
