"""From recorded data to parameters."""

from excitant.identify.dataset import Dataset, load_dataset
from excitant.identify.estimate import Data, Estimate, identify, split
from excitant.identify.recording import Recording, read_recording, recording_from_table
from excitant.identify.result import identify_result, identify_series, model_files

__all__ = [
    "Data",
    "Dataset",
    "Estimate",
    "Recording",
    "identify",
    "identify_result",
    "identify_series",
    "load_dataset",
    "model_files",
    "read_recording",
    "recording_from_table",
    "split",
]
