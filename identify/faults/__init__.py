"""Faults of a recording, found before anything is fitted to it."""

from excitant.identify.faults.copies import find_copies
from excitant.identify.faults.fault import FAULTS, Fault
from excitant.identify.faults.find import find_faults
from excitant.identify.faults.log import Log
from excitant.identify.faults.reading import Checked, read_checked
from excitant.identify.faults.repair import repair

__all__ = [
    "FAULTS",
    "Checked",
    "Fault",
    "Log",
    "find_copies",
    "find_faults",
    "read_checked",
    "repair",
]
