"""Logs of any kind as recordings: formats, columns, units, time."""

from excitant.identify.importers.mapping import ColumnMap, Drive, column_map, load_column_map
from excitant.identify.importers.raw import RawRecording, raw_recording
from excitant.identify.importers.sources import open_source

__all__ = [
    "ColumnMap",
    "Drive",
    "RawRecording",
    "column_map",
    "load_column_map",
    "open_source",
    "raw_recording",
]
