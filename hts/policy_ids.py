"""The id of the policy that a run starts from, beside those of its candidates."""

from __future__ import annotations

PRETRAINED = "pretrained"
"""It is the reference of every comparison, and the best while nobody else is."""
