"""Which recordings a model is fitted to, and which are held out."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from hts.config import ScheduleConfig
    from hts.recordings.recording import Recording

WHOLE_POLICIES_FROM = 4  # with fewer policies each one is needed for fitting


def split(
    recordings: Sequence[Recording], share: float, seed: int = 0, keep: Collection[str] = ()
) -> tuple[list[Recording], list[Recording]]:
    """Recordings to fit on, and about `share` of them held out: whole policies first, then single recordings.

    From four policies on, `share` of them are held out whole, at least one; never the one with the most
    recordings nor those whose hash is in `keep`. Then one recording each of other policies that have several,
    until the share is reached. Where each policy has a single recording, and there are too few for whole ones, one that
    is not in `keep` is held out, if there is one. Same recordings and seed, same split.

    Of a single recording nothing is held out: its own end, seconds after what was fitted, says nothing of another walk.
    """
    if len(recordings) == 1:
        return [recordings[0]], []
    rng = np.random.default_rng(seed)
    by_policy: dict[str, list[int]] = defaultdict(list)
    for index, recording in enumerate(recordings):
        by_policy[recording.policy_hash].append(index)
    policies = [list(by_policy)[i] for i in rng.permutation(len(by_policy))]
    budget = max(1, round(share * len(recordings)))
    held: list[int] = []
    if len(policies) >= WHOLE_POLICIES_FROM:
        most = max(policies, key=lambda policy: len(by_policy[policy]))
        free = [policy for policy in policies if policy != most and policy not in keep]
        for policy in free[: max(1, round(share * len(policies)))]:
            held += by_policy.pop(policy)
    queues = {policy: [indices[i] for i in rng.permutation(len(indices))] for policy, indices in by_policy.items()}
    while len(held) < budget and any(len(queue) > 1 for queue in queues.values()):
        for policy in policies:
            if len(held) < budget and len(queues.get(policy, ())) > 1:
                held.append(queues[policy].pop())
    spare = [policy for policy in policies if policy not in keep]
    if not held and spare:  # every policy has one recording, and none could be spared by the rule above
        held.append(queues[spare[-1]].pop())
    chosen = set(held)
    return (
        [recording for index, recording in enumerate(recordings) if index not in chosen],
        [recording for index, recording in enumerate(recordings) if index in chosen],
    )


def of_fitted_sessions(training: Sequence[Recording], held_out: Sequence[Recording]) -> int:
    """How many of those held out are of a session, or of a recording, of which others were fitted to. A session without
    a name is nobody's."""
    known = {name for one in training for name in _whence(one)}
    return sum(bool(known.intersection(_whence(one))) for one in held_out)


def _whence(recording: Recording) -> list[tuple[str, str]]:
    """The session and the recording that it is, or is a part of (`named_part`); without those that have no name."""
    names = {"session": recording.session, "recording": recording.id.partition("[")[0]}
    return [(key, name) for key, name in names.items() if name]


def left_out_together(recordings: Sequence[Recording], most: int) -> list[int]:
    """For a cross-validation, the fold of each recording, below `most`: whole policies from four on, else single
    recordings. One that stands several times in the list, as in a bootstrap, is left out with its twins, which know
    every sample of it."""
    policies = [recording.policy_hash for recording in recordings]
    names = policies if len(set(policies)) >= WHOLE_POLICIES_FROM else same_samples(recordings)
    order = list(dict.fromkeys(names))
    return [order.index(name) % most for name in names]


def same_samples(recordings: Sequence[Recording]) -> list[int]:
    """For each recording the place of the first that holds the same samples: its own, unless it is a twin. Ids do not
    tell, since parts of a recording have none."""
    found: dict[bytes, int] = {}
    return [found.setdefault(_digest(recording), index) for index, recording in enumerate(recordings)]


def _digest(recording: Recording) -> bytes:
    digest = hashlib.blake2b(recording.time.tobytes())
    for name in sorted(recording.channels):
        digest.update(recording.values(name).tobytes())
    return digest.digest()


def part(recording: Recording, start: int, stop: int) -> Recording:
    """Samples start to stop of a recording, as a recording."""
    from hts.recordings.recording import Series

    channels = {name: Series(s.channel, s.values[start:stop]) for name, s in recording.channels.items()}
    changes = {"time": recording.time[start:stop], "channels": channels}
    return recording.replace(**changes, schedule=_schedule_from(recording.schedule, start / recording.rate_hz))


def named_part(recording: Recording, start: int, stop: int) -> Recording:
    """The same, called by its recording's id and the samples, so that reports can say what it is."""
    whole = (start, stop) == (0, recording.num_samples)
    return recording if whole else part(recording, start, stop).replace(id=f"{recording.id}[{start}:{stop}]")


def _schedule_from(schedule: ScheduleConfig, seconds: float) -> ScheduleConfig:
    """What is commanded from so many seconds on; the last command lasts."""
    commands = list(schedule.commands)
    while len(commands) > 1 and seconds >= commands[0].seconds:
        seconds -= commands.pop(0).seconds
    left = commands[0].seconds - seconds
    first = commands[0].model_copy(update={"seconds": left if left > 0 else commands[0].seconds})
    return schedule.model_copy(update={"commands": (first, *commands[1:])})
