from .dataset import (
    Dataset,
    is_dataset,
    load_dataset,
    origin,
    read_checked,
    read_recordings,
)
from .differentiators import LocalPolynomial
from .drive_gains import DriveGains, KnownPayload
from .estimate import Estimate, identify_robot
from .estimators import ESTIMATORS
from .excitation import WindowExcitation, persistency
from .export import (
    FORMATS,
    USUAL,
    Publication,
    model_files,
    publication,
    published,
    save_model,
)
from .faults import (
    Checked,
    check_recordings,
    proven,
    refuse_positions_beyond,
    warn_of_faults,
)
from .knowledge import Knowledge, load_knowledge
from .mujoco import side_by_side
from .online import (
    Monitor,
    OnlineEstimate,
    OnlineEstimator,
    OnlineIdentification,
    identify_online,
)
from .parked import Parked, freed_for, parked
from .payload import (
    PayloadEstimate,
    PayloadEstimator,
    estimate_payload,
    identify_drive_gains,
    identify_payload,
)
from .preprocessing import prepare
from .reading.logs import (
    load_recording,
    raw_recording,
    read_chunks,
    recording_from_table,
)
from .reading.mapping import ColumnMap, load_column_map
from .recording import MINIMUM_DURATION, Recording, recordings_of
from .regression import Regression
from .rows import FIT_SHARE, Data, fitted, split
from .sequential import LinkByLink, identify_link_by_link

__all__ = [
    "ESTIMATORS",
    "FIT_SHARE",
    "FORMATS",
    "MINIMUM_DURATION",
    "USUAL",
    "Checked",
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
    "Parked",
    "PayloadEstimate",
    "PayloadEstimator",
    "Publication",
    "Recording",
    "Regression",
    "WindowExcitation",
    "check_recordings",
    "estimate_payload",
    "fitted",
    "freed_for",
    "identify_drive_gains",
    "identify_link_by_link",
    "identify_online",
    "identify_payload",
    "identify_robot",
    "is_dataset",
    "load_column_map",
    "load_dataset",
    "load_knowledge",
    "load_recording",
    "model_files",
    "origin",
    "parked",
    "persistency",
    "prepare",
    "proven",
    "publication",
    "published",
    "raw_recording",
    "read_checked",
    "read_chunks",
    "read_recordings",
    "recording_from_table",
    "recordings_of",
    "refuse_positions_beyond",
    "save_model",
    "side_by_side",
    "split",
    "warn_of_faults",
]
