"""An identified model as files for other programs."""

from excitant.identify.export.publication import FORMATS, Publication, model_files, publication

__all__ = ["FORMATS", "Publication", "model_files", "publication"]
