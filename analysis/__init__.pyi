from .confirmation import Finding
from .diagnosis import Diagnosis, diagnose
from .effect_choice import choose_effects
from .examination import Examination, examine
from .identifiability import Identifiability, analyze
from .shown import identify_shown

__all__ = [
    "Diagnosis",
    "Examination",
    "Finding",
    "Identifiability",
    "analyze",
    "choose_effects",
    "diagnose",
    "examine",
    "identify_shown",
]
