"""Formats of files of surfaces: one file for each, which makes a `Scan` of it."""
