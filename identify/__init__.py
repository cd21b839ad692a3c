"""From recorded data to parameters."""

from excitant.identify.dataset import Dataset, load_dataset
from excitant.identify.differentiator_choice import choose_differentiator
from excitant.identify.differentiators import (
    Differentiator,
    FourierFit,
    LocalPolynomial,
    ZeroPhaseButterworth,
    five_point,
    savitzky_golay,
)
from excitant.identify.estimate import Estimate, identify
from excitant.identify.excitation import Persistency, persistency
from excitant.identify.online import OnlineEstimator
from excitant.identify.online_estimate import OnlineEstimate
from excitant.identify.online_result import identify_online, online_result, online_series
from excitant.identify.payload import PayloadEstimate, estimate_payload, payload_result
from excitant.identify.payload_run import identify_payload
from excitant.identify.recording import Recording, read_recording, recording_from_table
from excitant.identify.replay import Monitor, replay
from excitant.identify.result import identify_result, identify_series, model_files
from excitant.identify.rows import Data, split

__all__ = [
    "Data",
    "Dataset",
    "Differentiator",
    "Estimate",
    "FourierFit",
    "LocalPolynomial",
    "Monitor",
    "OnlineEstimate",
    "OnlineEstimator",
    "PayloadEstimate",
    "Persistency",
    "Recording",
    "ZeroPhaseButterworth",
    "choose_differentiator",
    "estimate_payload",
    "five_point",
    "identify",
    "identify_online",
    "identify_payload",
    "identify_result",
    "identify_series",
    "load_dataset",
    "model_files",
    "online_result",
    "online_series",
    "payload_result",
    "persistency",
    "read_recording",
    "recording_from_table",
    "replay",
    "savitzky_golay",
    "split",
]
