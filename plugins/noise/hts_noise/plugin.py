"""Registers what this package offers. Imports nothing heavy."""

from __future__ import annotations

HTS_API = 1
