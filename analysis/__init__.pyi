from .confirmation import Finding
from .diagnosis import Diagnosis, diagnose
from .examination import Examination, examine
from .experiment import identify_shown
from .identifiability import Identifiability, analyze

__all__ = [
    "Diagnosis",
    "Examination",
    "Finding",
    "Identifiability",
    "analyze",
    "diagnose",
    "examine",
    "identify_shown",
]
