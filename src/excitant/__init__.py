"""Excitation design, identification, identifiability and diagnosis of robot arms."""

__version__ = "0.1.0"
