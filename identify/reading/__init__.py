"""Logs of any kind as recordings: formats, columns, units, time."""
