"""Figures of the pages, built as data from results and series."""
