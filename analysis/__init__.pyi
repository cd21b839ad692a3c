from .confirmation import Finding
from .diagnosis import Diagnosis, diagnose
from .diagnosis_result import Plan, with_repairs
from .discrimination_plan import plan
from .effect_choice import choose_effects, described
from .examination import Examination, examine
from .fleet import Examined, Fleet, Value, compare_arms
from .identifiability import Identifiability, analyze
from .publication import extended_publication
from .rehearsal import Rehearsal, rehearse
from .shown import identify_shown
from .uncertainty import default_noise

__all__ = [
    "Diagnosis",
    "Examination",
    "Examined",
    "Finding",
    "Fleet",
    "Identifiability",
    "Plan",
    "Rehearsal",
    "Value",
    "analyze",
    "choose_effects",
    "compare_arms",
    "default_noise",
    "described",
    "diagnose",
    "examine",
    "extended_publication",
    "identify_shown",
    "plan",
    "rehearse",
    "with_repairs",
]
