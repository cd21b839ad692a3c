"""Identification of logs larger than memory, in one pass over them and one over their time."""

from excitant.identify.streaming.budget import larger_than_memory
from excitant.identify.streaming.identify import identify_streamed

__all__ = ["identify_streamed", "larger_than_memory"]
