"""One thread for linear algebra: the same digits on every machine, and faster on small matrices."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
T = TypeVar("T")


def on_one_thread(verb: Callable[P, T]) -> Callable[P, T]:
    """The same function, its sums in the same order whatever the number of BLAS threads."""

    @wraps(verb)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        with threadpool_limits(1):
            return verb(*args, **kwargs)

    return run
