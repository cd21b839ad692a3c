"""Excitation design, identification, identifiability and diagnosis of robot arms.

The verbs and nouns of every day are at hand as ``import excitant as ex``: ``ex.load_robot``,
``ex.design_trajectory``, ``ex.check``, ``ex.simulate``, ``ex.load_recording``,
``ex.identify_robot``, ``ex.analyze``, ``ex.diagnose``, ``ex.go``, ``ex.rehearse``, ``ex.report``:
the functions of `excitant.api`, which the commands call too. Each is imported when it is first
used; everything else is in the packages ``excitant.robots``, ``design``, ``identify``,
``analysis``, ``reports``, whose functions take nouns only.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, _, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = [*_names, "__version__"]


def __dir__() -> list[str]:
    return __all__
