"""What is done on a twin: sessions made of blocks. All robots of a batch change blocks at the same moments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import Field

from hts.config import Config, ScheduleConfig
from hts.worlds.base import ORDER, request_id, round_order, walking

SETTLING_SECONDS = 3.0  # of the warm-up, before heat is averaged: the start from standing is not like walking
STANDING_SECONDS = 1.0  # before anything else


class Block(Config):
    """A stretch with one policy under one schedule."""

    policy: str | None = Field(description="path of its ONNX file; null: stand in the default pose")
    schedule: ScheduleConfig = Field(description="what is commanded, and for how long")
    recorded: bool = Field(True, description="whether it becomes a recording")
    settle: bool = Field(
        False, description="when it ends, bring the instruments' heat to the steady state of what went before"
    )
    index: int = Field(0, ge=0, description="number of a recorded block in its session")
    role: Literal["collection", "policy", "reference"] = Field(
        "collection", description="first data, or a block of the policy or of its reference in a head-to-head"
    )


class Session(Config):
    """All that happens on one robot, from switching it on."""

    id: str = Field(description="what its recordings are marked with")
    blocks: tuple[Block, ...] = Field(description="one after the other, without a pause")

    @property
    def seconds(self) -> float:
        return sum(block.schedule.seconds for block in self.blocks)


def standing_up() -> Block:
    """Stand in the default pose, before anything else."""
    return Block(policy=None, schedule=walking(0.0, STANDING_SECONDS), recorded=False)


def collection(policies: Sequence[str | None], schedule: ScheduleConfig, request: str) -> list[Session]:
    """One session a policy: stand up, then the schedule. Motors start at the instruments' stated temperature."""
    return [
        Session(id=request_id(request, number), blocks=(standing_up(), Block(policy=policy, schedule=schedule)))
        for number, policy in enumerate(policies)
    ]


def warm_up(policy: str | None, speed: float, seconds: float) -> tuple[Block, ...]:
    """Stand up, walk, and bring heat to the steady state of that.

    It settles twice: once after the first seconds, so that windings are warm while heat is averaged, and at the end.
    """
    first = min(SETTLING_SECONDS, seconds / 2)
    parts = (first, seconds - first)
    walks = [Block(policy=policy, schedule=walking(speed, part), recorded=False, settle=True) for part in parts]
    return (standing_up(), *walks)


def head_to_head(policy: str, reference: str, speed: float, warmup: float, block: float, session: str) -> Session:
    """Warm up with the reference, then reference - policy - policy - reference, without a pause."""
    paths = {"policy": policy, "reference": reference}
    walk = walking(speed, block)
    blocks = [Block(policy=paths[role], schedule=walk, index=i, role=role) for i, role in enumerate(ORDER)]
    return Session(id=session, blocks=(*warm_up(reference, speed, warmup), *blocks))


def head_to_head_round(
    policies: Sequence[str], reference: str, speed: float, warmup: float, block: float, number: int, session: str
) -> Session:
    """Warm up with the reference, then a round of all policies in one session, without a pause."""
    walk = walking(speed, block)
    blocks = [
        Block(policy=reference, schedule=walk, index=i, role="reference")
        if who is None
        else Block(policy=policies[who], schedule=walk, index=i, role="policy")
        for i, who in enumerate(round_order(len(policies), number))
    ]
    return Session(id=session, blocks=(*warm_up(reference, speed, warmup), *blocks))
