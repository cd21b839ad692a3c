"""What can be known, how well, and what the model gets wrong."""

from excitant.analysis.confirmation import Finding
from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.analysis.experiment import identify_shown
from excitant.analysis.identifiability import Identifiability, analyze

__all__ = [
    "Diagnosis",
    "Finding",
    "Identifiability",
    "analyze",
    "diagnose",
    "identify_shown",
]
