"""Sections of the reports: one file for each, with its table, figure and notes."""
