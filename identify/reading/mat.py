"""MAT files, loaded in a child process: SciPy trusts them, and a damaged one may end it."""

import math
import pickle
from pathlib import Path
from typing import Any

from excitant.identify.reading.arrays import MOST, refuse_size
from excitant.limited import Exceeded, in_child

_BYTES = {"double": 8, "single": 4} | {
    f"{u}int{8 * k}": k for u in ("", "u") for k in (1, 2, 4, 8)
}
_SECONDS = 300  # of processor time that a file of the largest size may take


def loaded(path: Path, size: int) -> dict[str, Any]:
    """Variables of a MAT file of version 4 to 7.2, unpacked ``size`` bytes long, by name.

    Raises:
        ValueError: A damaged file, or one whose variables would not fit into memory.
    """
    task = (str(path), size)
    try:
        answer = in_child(load, *task, seconds=_SECONDS, memory=4 * MOST)
    except Exceeded:
        raise ValueError("it is damaged") from None
    content: dict[str, Any] = pickle.loads(answer)
    return content


def load(path: str, size: int) -> bytes:
    """Variables of a file, pickled; ValueError where they are not as long as they claim to be."""
    import scipy.io

    try:
        headers = scipy.io.whosmat(path)
    except TypeError:  # SciPy reads objects of MATLAB's, but not their headers
        headers = []
    variables = [(name, math.prod(shape), kind) for name, shape, kind in headers]
    refuse_size(sum(count * _BYTES.get(kind, 0) for _, count, kind in variables))
    for name, count, kind in variables:
        if kind in _BYTES and count > size:
            raise ValueError(f"{name} is shorter than its header says")
    return pickle.dumps(scipy.io.loadmat(path, simplify_cells=True))
