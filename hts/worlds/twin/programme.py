"""What is done on a twin: sessions made of blocks. All robots of a batch change blocks at the same moments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import Field

from hts.config import Config, ScheduleConfig
from hts.contracts import HoldSpeed
from hts.worlds.base import request_id, round_order, walking

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
    session: str | None = Field(None, description="name of its recording's session; null: that of the robot's session")
    speed: Literal["open", "trim", "held"] = Field(
        "open",
        description="open: the schedule is the command; trim: the command follows the measured speed, and what it ends "
        "at is kept; held: what was kept of this policy at this speed is the command",
    )


class Kept(Config):
    """A command that was found before this session: of a policy at an asked speed, both in m/s."""

    policy: str = Field(description="path of its ONNX file")
    asked: float = Field(description="speed to be held, m/s")
    command: float = Field(description="what was found to hold it, m/s")
    saturated: bool = Field(description="whether that lies at the end of the allowed commands")


class Session(Config):
    """All that happens on one robot, from switching it on."""

    id: str = Field(description="what its recordings are marked with")
    blocks: tuple[Block, ...] = Field(description="one after the other, without a pause")
    hold: HoldSpeed | None = Field(None, description="how blocks trim; null: none does")
    kept: tuple[Kept, ...] = Field((), description="commands that were found before")

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


def warm_up(policy: str | None, speed: float, seconds: float, trimming: float | None = None) -> tuple[Block, ...]:
    """Stand up, walk, and bring heat to the steady state of that.

    It settles twice: once after the first seconds, so that windings are warm while heat is averaged, and at the end.
    trimming: s; the walk after the first seconds is long enough for it and trims.
    """
    first = min(SETTLING_SECONDS, seconds / 2)
    rest = seconds - first if trimming is None else max(seconds - first, trimming)
    begin = Block(policy=policy, schedule=walking(speed, first), recorded=False, settle=True)
    kind: Literal["open", "trim"] = "open" if trimming is None else "trim"
    walk = Block(policy=policy, schedule=walking(speed, rest), recorded=False, settle=True, speed=kind)
    return (standing_up(), begin, walk)


def head_to_head(
    policies: Sequence[str],
    reference: str,
    speeds: Sequence[float],
    warmup: float,
    block: float,
    session: str,
    number: int = 0,
    hold: HoldSpeed | None = None,
    kept: Sequence[Kept] = (),
) -> Session:
    """Warm up with the reference, then at each speed all policies there and back, without a pause.

    With one policy a speed is reference - policy - policy - reference; number: of a round, says who begins.
    hold: each policy trims before its first block at a speed, unless `kept` knows its command; the reference's
    trimming at the first speed is a part of the warm-up. Blocks of each speed carry a session's name of their own where
    there are several.
    """
    known = {(one.policy, one.asked) for one in kept}

    def trims(path: str, speed: float) -> bool:
        return hold is not None and (path, speed) not in known

    trimming = hold.seconds if hold is not None and trims(reference, speeds[0]) else None
    blocks = list(warm_up(reference, speeds[0], warmup, trimming))
    for speed in speeds:
        name = session if len(speeds) == 1 else request_id(session, speed)
        for path in (*(() if speed == speeds[0] else (reference,)), *dict.fromkeys(policies)):
            if hold is not None and trims(path, speed):
                walk = walking(speed, hold.seconds)
                blocks.append(Block(policy=path, schedule=walk, recorded=False, speed="trim"))
        blocks += [
            Block(
                policy=reference if who is None else policies[who],
                schedule=walking(speed, block),
                index=index,
                role="reference" if who is None else "policy",
                session=name,
                speed="open" if hold is None else "held",
            )
            for index, who in enumerate(round_order(len(policies), number))
        ]
    return Session(id=session, blocks=tuple(blocks), hold=hold, kept=tuple(kept))


def session_seconds(policies: int, speeds: int, warmup: float, block: float, hold: HoldSpeed | None) -> float:
    """Length of such a session without its standing up, s; nothing known before."""
    walks = [str(number) for number in range(policies)]
    made = head_to_head(walks, "reference", [float(n) for n in range(speeds)], warmup, block, "", hold=hold)
    return made.seconds - STANDING_SECONDS
