"""Cases of a test that are slow."""

from functools import partial

import pytest

slow = partial(pytest.param, marks=pytest.mark.slow)
"""``slow(1, 2)``: these values of the parameters, in the suite of all tests."""
