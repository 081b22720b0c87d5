"""What is done on a twin: sessions made of blocks. All robots of a batch change blocks at the same moments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hts.config import ScheduleConfig
from hts.worlds.base import ORDER, request_id, walking

SETTLING_SECONDS = 3.0  # of the warm-up, before heat is averaged: the start from standing is not like walking
STANDING_SECONDS = 1.0  # before anything else


@dataclass(frozen=True)
class Block:
    """A stretch with one policy (path of its ONNX file; None: stand in the default pose) under one schedule.

    recorded: whether it becomes a recording; settle: bring the instruments' heat to the steady state of what went
    before, when this block ends; index: number of a recorded block in its session; role: as `Recording.role`.
    """

    policy: str | None
    schedule: ScheduleConfig
    recorded: bool = True
    settle: bool = False
    index: int = 0
    role: str = "collection"


@dataclass(frozen=True)
class Session:
    """All that happens on one robot, from switching it on; `id` names it."""

    id: str
    blocks: tuple[Block, ...]

    @property
    def seconds(self) -> float:
        return sum(block.schedule.seconds for block in self.blocks)


def standing_up() -> Block:
    """Stand in the default pose, before anything else."""
    return Block(None, walking(0.0, STANDING_SECONDS), recorded=False)


def collection(policies: Sequence[str | None], schedule: ScheduleConfig, request: str) -> list[Session]:
    """One session a policy: stand up, then the schedule. Motors start at the instruments' stated temperature."""
    return [
        Session(request_id(request, number), (standing_up(), Block(policy, schedule)))
        for number, policy in enumerate(policies)
    ]


def head_to_head(policy: str, reference: str, speed: float, warmup: float, block: float, session: str) -> Session:
    """Stand up, warm up with the reference, settle the heat, then reference - policy - policy - reference.

    The warm-up settles twice: once after its first seconds, so that windings are warm while heat is averaged,
    and once at its end.
    """
    first = min(SETTLING_SECONDS, warmup / 2)
    blocks = [
        standing_up(),
        Block(reference, walking(speed, first), recorded=False, settle=True),
        Block(reference, walking(speed, warmup - first), recorded=False, settle=True),
    ]
    paths = {"policy": policy, "reference": reference}
    blocks += [Block(paths[role], walking(speed, block), index=i, role=role) for i, role in enumerate(ORDER)]
    return Session(session, tuple(blocks))
