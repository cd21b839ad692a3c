"""Faults of a recording, found before anything is fitted to it."""

from excitant.identify.faults.channels import find_copies
from excitant.identify.faults.fault import FAULTS, Fault, repair
from excitant.identify.faults.find import Checked, find_faults, read_checked
from excitant.identify.faults.log import Log

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
