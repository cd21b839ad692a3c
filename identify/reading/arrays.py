"""Archives of arrays, and the size up to which data are read."""

import math
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

MOST = 2 << 30
"""Bytes of the numbers of a log that is read at once."""

_READ_HEADER = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read_arrays(source: Path | bytes) -> dict[str, Any]:
    """Arrays of an NPZ file by name; ValueError before more than `MOST` is taken for them.

    An array takes what its header claims, whatever the file then holds.
    """
    arrays = {}
    with zipfile.ZipFile(
        BytesIO(source) if isinstance(source, bytes) else source
    ) as archive:
        refuse_size(sum(member.file_size for member in archive.infolist()))
        for member in archive.infolist():
            with archive.open(member) as stream:
                version = np.lib.format.read_magic(stream)
                shape, _, dtype = _READ_HEADER[version](stream)
            if (
                not dtype.hasobject
                and math.prod(shape) * dtype.itemsize > member.file_size
            ):
                raise ValueError(
                    f"{member.filename} is shorter than its header says"
                )
            with archive.open(member) as stream:
                values = np.lib.format.read_array(stream, allow_pickle=False)
            arrays[member.filename.removesuffix(".npy")] = values
    return arrays


def refuse_size(size: float) -> None:
    """Refuse, as ValueError, data of so many bytes where they would not fit into memory."""
    if size > MOST:
        most = f"at most {MOST / 1e9:.3g} GB are read at once"
        raise ValueError(
            f"holds {size / 1e9:.3g} GB, {most}: cut it, or save it as Parquet"
        )
