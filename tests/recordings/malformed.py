"""Logs and mappings that are not what they should be, by kind: a table, and what makes a case of each.

Every kind takes a whole log and its mapping and spoils one thing. `BAD` must be refused, `GOOD` is unusual and must be
stored as it is, `EITHER` flips bits or cuts binary files, where damage may lie in what nobody reads.
"""

from __future__ import annotations

import malformed_binary
import malformed_mappings
import malformed_text
import unusual
from malformed_case import BAD, EITHER, GOOD, ROBOT, case

__all__ = ["BAD", "EITHER", "GOOD", "ROBOT", "case"]

KINDS = (malformed_text, malformed_mappings, malformed_binary, unusual)
"""Whoever is imported has put its kinds into the tables."""
