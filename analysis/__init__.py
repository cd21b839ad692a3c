"""What can be known, how well, and what the model gets wrong."""

from excitant.analysis.diagnosis import Diagnosis, Finding, diagnose
from excitant.analysis.diagnosis_result import diagnose_result, diagnose_series, headline
from excitant.analysis.identifiability import Identifiability, analyze, analyze_result

__all__ = [
    "Diagnosis",
    "Finding",
    "Identifiability",
    "analyze",
    "analyze_result",
    "diagnose",
    "diagnose_result",
    "diagnose_series",
    "headline",
]
