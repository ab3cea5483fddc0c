"""Doctests: a room whose functions are called like their files is imported whole, before pytest imports its files."""

from __future__ import annotations

import flexhinf.identification as _  # noqa: F401
