"""Sections of the reports: each a generator of notes, paragraphs, tables and figures yet to be drawn."""
