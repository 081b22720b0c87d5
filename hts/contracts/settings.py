"""What a plugin's factory is given."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Settings = Mapping[str, Any]
"""A plugin's settings as they stand in a configuration; its factory validates them."""
