"""Datasheet: a report in, documents out. Nothing is measured here and nothing is computed but units.

text    the table on a terminal
"""
