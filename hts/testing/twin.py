"""The twin for those who calibrate it: its parameters, its machine, and one session of it, step by step.

For commands of instrument authors that hold a twin against the real machine's data sheets, such as a table of its
calibration anchors. Never for an objective, a reward or a measurement model: what learns may not look into a world.
"""

from hts.worlds.base import Operator, request_id, seed_sequence, walking
from hts.worlds.twin.instruments import instruments_of_reality, make_instruments, maker
from hts.worlds.twin.model import build
from hts.worlds.twin.parameters import TwinSettings, parameters_hash, resolved, resolved_settings
from hts.worlds.twin.programme import Block, Session, warm_up
from hts.worlds.twin.session import Batch

__all__ = [
    "Batch",
    "Block",
    "Operator",
    "Session",
    "TwinSettings",
    "build",
    "instruments_of_reality",
    "make_instruments",
    "maker",
    "parameters_hash",
    "request_id",
    "resolved",
    "resolved_settings",
    "seed_sequence",
    "walking",
    "warm_up",
]
