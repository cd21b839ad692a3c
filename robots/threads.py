"""One thread for linear algebra: the same digits on every machine, and faster on small matrices."""

from collections.abc import Callable
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

Verb = TypeVar("Verb", bound=Callable[..., Any])


def on_one_thread(verb: Verb) -> Verb:
    """The same function, its sums in the same order whatever the number of BLAS threads."""
    return threadpool_limits.wrap(limits=1)(verb)
