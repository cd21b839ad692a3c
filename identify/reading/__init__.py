"""Logs of any kind as recordings; `logs` is the entry.

A format is a function from a path to a `tables.Table`, and a row of the table of formats in `logs`.
A word that a vendor writes into names of columns is a word in the tables of `names`, a unit is a
row of the table in `units`.
"""
