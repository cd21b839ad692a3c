"""An identified model as files for other programs."""

from excitant.identify.export.code import c_function, python_module
from excitant.identify.export.files import DEFAULT_FORMATS, FORMATS, model_files
from excitant.identify.export.mjcf import mjcf_text
from excitant.identify.export.publication import Publication, publication
from excitant.identify.export.sdf import sdf_text
from excitant.identify.export.urdf import urdf_text

__all__ = [
    "DEFAULT_FORMATS",
    "FORMATS",
    "Publication",
    "c_function",
    "mjcf_text",
    "model_files",
    "publication",
    "python_module",
    "sdf_text",
    "urdf_text",
]
