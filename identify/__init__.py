"""From recorded data to parameters."""

from excitant.identify.dataset import Dataset, load_dataset
from excitant.identify.differentiators import (
    Differentiator,
    LocalPolynomial,
    ZeroPhaseButterworth,
    five_point,
    savitzky_golay,
)
from excitant.identify.drive_gains import DriveGains, KnownPayload, identify_drive_gains
from excitant.identify.estimate import Estimate, identify
from excitant.identify.excitation import Persistency, persistency
from excitant.identify.export import Publication, model_files, publication
from excitant.identify.importers.mapping import ColumnMap, load_column_map
from excitant.identify.importers.raw import RawRecording, raw_recording
from excitant.identify.knowledge import Knowledge, load_knowledge
from excitant.identify.monitor import Monitor, identify_online, replay
from excitant.identify.online import OnlineEstimate, OnlineEstimator
from excitant.identify.payload import PayloadEstimate, estimate_payload, identify_payload
from excitant.identify.recording import (
    Recording,
    read_chunks,
    read_recording,
    read_recordings,
    recording_from_raw,
    recording_from_table,
)
from excitant.identify.regression import Regression
from excitant.identify.rows import Data, split
from excitant.identify.sequential import LinkByLink, identify_link_by_link

__all__ = [
    "ColumnMap",
    "Data",
    "Dataset",
    "Differentiator",
    "DriveGains",
    "Estimate",
    "Knowledge",
    "KnownPayload",
    "LinkByLink",
    "LocalPolynomial",
    "Monitor",
    "OnlineEstimate",
    "OnlineEstimator",
    "PayloadEstimate",
    "Persistency",
    "Publication",
    "RawRecording",
    "Recording",
    "Regression",
    "ZeroPhaseButterworth",
    "estimate_payload",
    "five_point",
    "identify",
    "identify_drive_gains",
    "identify_link_by_link",
    "identify_online",
    "identify_payload",
    "load_column_map",
    "load_dataset",
    "load_knowledge",
    "model_files",
    "persistency",
    "publication",
    "raw_recording",
    "read_chunks",
    "read_recording",
    "read_recordings",
    "recording_from_raw",
    "recording_from_table",
    "replay",
    "savitzky_golay",
    "split",
]
