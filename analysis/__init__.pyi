from .confirmation import Finding
from .diagnosis import Diagnosis, diagnose
from .diagnosis_result import diagnose_result, diagnose_series
from .experiment import identify_shown
from .identifiability import Identifiability, analyze

__all__ = [
    "Diagnosis",
    "Finding",
    "Identifiability",
    "analyze",
    "diagnose",
    "diagnose_result",
    "diagnose_series",
    "identify_shown",
]
