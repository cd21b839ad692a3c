from .dataset import Dataset, load_dataset, read_recordings
from .differentiators import LocalPolynomial
from .drive_gains import DriveGains, KnownPayload
from .estimate import Estimate, identify_robot
from .excitation import Persistency, persistency
from .export import Publication, model_files, publication, published, save_model
from .knowledge import Knowledge, load_knowledge
from .online import (
    Monitor,
    OnlineEstimate,
    OnlineEstimator,
    OnlineIdentification,
    identify_online,
)
from .payload import (
    PayloadEstimate,
    PayloadEstimator,
    estimate_payload,
    identify_drive_gains,
    identify_payload,
)
from .reading.logs import (
    load_recording,
    raw_recording,
    read_chunks,
    recording_from_table,
)
from .reading.mapping import ColumnMap, load_column_map
from .recording import Recording
from .regression import Regression
from .rows import Data, split
from .sequential import LinkByLink, identify_link_by_link

__all__ = [
    "ColumnMap",
    "Data",
    "Dataset",
    "DriveGains",
    "Estimate",
    "Knowledge",
    "KnownPayload",
    "LinkByLink",
    "LocalPolynomial",
    "Monitor",
    "OnlineEstimate",
    "OnlineEstimator",
    "OnlineIdentification",
    "PayloadEstimate",
    "PayloadEstimator",
    "Persistency",
    "Publication",
    "Recording",
    "Regression",
    "estimate_payload",
    "identify_drive_gains",
    "identify_link_by_link",
    "identify_online",
    "identify_payload",
    "identify_robot",
    "load_column_map",
    "load_dataset",
    "load_knowledge",
    "load_recording",
    "model_files",
    "persistency",
    "publication",
    "published",
    "raw_recording",
    "read_chunks",
    "read_recordings",
    "recording_from_table",
    "save_model",
    "split",
]
