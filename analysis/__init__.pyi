from .confirmation import Finding
from .diagnosis import Diagnosis, diagnose
from .experiment import identify_shown
from .identifiability import Identifiability, analyze

__all__ = ["Diagnosis", "Finding", "Identifiability", "analyze", "diagnose", "identify_shown"]
