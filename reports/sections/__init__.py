"""Sections of the pages, one for each verb."""
