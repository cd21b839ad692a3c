"""Identification of logs larger than memory: searched for faults in one pass, fitted in another."""

from excitant.identify.streaming.budget import larger_than_memory
from excitant.identify.streaming.estimate import StreamedEstimate
from excitant.identify.streaming.identify import identify_streamed

__all__ = ["StreamedEstimate", "identify_streamed", "larger_than_memory"]
