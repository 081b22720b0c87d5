"""What a lab would have recorded of its robot before any fine-tuning, of a reality: the policy to start from at each
speed, warm, in several sessions, and standing. Only the twin's own process knows what is in the reality."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hts import plugins
from hts.config import Command, ScheduleConfig
from hts.contracts import WorldContext
from hts.recordings.store import RecordingStore
from hts.worlds.twin.world import make_twin

STANDING_SECONDS = 10.0


@dataclass(frozen=True)
class Visit:
    """Sessions at each speed (m/s), each of a warm-up and four blocks, s."""

    speeds: tuple[float, ...] = (0.5, 0.8, 1.1)
    sessions: int = 4
    warmup: float = 10.0
    block: float = 10.0


def record(
    visit: Visit, robot: str, reality: str, objectives: Sequence[str], policy: Path, store: Path, seed: int = 0
) -> Path:
    """The store; made whole or not at all, and not again if it is there. policy: exported."""
    if store.exists():
        return store
    beside = store.with_name(store.name + ".part")
    shutil.rmtree(beside, ignore_errors=True)
    registry = plugins.load()
    context = WorldContext(robot, {}, {name: {} for name in objectives}, seed, beside / "world", registry)
    lengths = {"warmup_seconds": visit.warmup, "block_seconds": visit.block}
    world = make_twin({**({} if reality == "default" else {"reality": reality}), **lengths}, context)
    made = RecordingStore(beside / "data.zarr", create=True)
    try:
        standing = ScheduleConfig(commands=(Command(seconds=STANDING_SECONDS, vx=0.0),))
        walks = world.head_to_head_sessions(policy, policy, visit.speeds, visit.sessions)
        for one in [*world.collect([None] * visit.sessions, standing), *walks]:
            made.write(one)
    finally:
        world.close()
    (beside / "data.zarr").rename(store)
    shutil.rmtree(beside, ignore_errors=True)
    return store
