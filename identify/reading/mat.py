"""MAT files, loaded by a process of their own: one that is damaged may end it, as SciPy trusts it.

Run as a script, with the file, how many bytes its variables have, and how many they may claim.
"""

from __future__ import annotations

import math
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

_BYTES = {"double": 8, "single": 4} | {
    f"{u}int{8 * k}": k for u in ("", "u") for k in (1, 2, 4, 8)
}
_CLAIMS = "claims "  # bytes, in the words of a refusal


def loaded(path: Path, size: int) -> dict[str, Any]:
    """Variables of a MAT file of version 4 to 7.2, unpacked ``size`` bytes long, by name.

    Raises:
        ValueError: A damaged file, or one whose variables would not fit into memory.
    """
    from excitant.identify.reading.arrays import MOST, refuse_size

    words = [sys.executable, __file__, str(path), str(size), str(MOST)]
    done = subprocess.run(words, capture_output=True, check=False)
    if done.returncode == 0:
        content: dict[str, Any] = pickle.loads(done.stdout)
        return content
    said = done.stderr.decode(errors="replace").strip().splitlines()
    if said and said[-1].startswith(_CLAIMS):
        refuse_size(float(said[-1].removeprefix(_CLAIMS)))
    raise ValueError(said[-1] if said and done.returncode > 0 else "it is damaged")


def _load(path: str, size: int, most: int) -> dict[str, Any]:
    import scipy.io

    held = [(n, math.prod(shape), kind) for n, shape, kind in scipy.io.whosmat(path)]
    if (claimed := sum(count * _BYTES.get(kind, 0) for _, count, kind in held)) > most:
        raise ValueError(f"{_CLAIMS}{claimed}")
    for name, count, kind in held:
        if kind in _BYTES and count > size:
            raise ValueError(f"{name} is shorter than its header says")
    content: dict[str, Any] = scipy.io.loadmat(path, simplify_cells=True)
    return content


if __name__ == "__main__":
    try:
        variables = pickle.dumps(_load(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])))
    except Exception as error:
        sys.exit(" ".join(str(error).split()) or type(error).__name__)
    sys.stdout.buffer.write(variables)
