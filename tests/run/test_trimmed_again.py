"""A final at held speeds is trimmed again where policy and reference ended apart."""

from __future__ import annotations

import json
from types import SimpleNamespace

from hts.config import Command, EvaluationConfig, ScheduleConfig
from hts.contracts import HoldSpeed
from hts.run import finals


class World:
    """Ends apart at 0.5 m/s until it trims for so many seconds."""

    name = "made up"

    def __init__(self, until):
        self.asked, self.named, self.until = [], [], until

    def hold_speed(self, hold):
        self.hold = hold
        return True

    def head_to_head(self, policy, reference, speeds):
        self.asked.append((self.hold.seconds, tuple(speeds)))
        self.named.append(self.hold.named())
        return [
            SimpleNamespace(
                schedule=ScheduleConfig(commands=(Command(seconds=20.0, vx=speed),)),
                apart=speed == 0.5 and self.hold.seconds < self.until,
            )
            for speed in speeds
        ]


def held(monkeypatch, again, until=40.0):
    world = World(until)
    job = SimpleNamespace(
        world=world,
        config=SimpleNamespace(evaluation=EvaluationConfig(speeds=(0.5, 0.8), trims_again=again)),
        objectives={"power": None},
        robot=SimpleNamespace(task=lambda: None),
        exported=lambda name: name,
        seed=lambda *what: 0,
    )

    def apart(objective, recordings, config, seed, task):
        return [one.schedule.commands[0].vx for one in recordings if one.apart]

    monkeypatch.setattr(finals, "speeds_missed", apart)
    return world, *finals._held(job, HoldSpeed((0.2, 1.5), 12.0, 0.01))


def test_only_the_speed_that_ended_apart_is_done_again_and_longer_each_time(monkeypatch):
    world, good, vain = held(monkeypatch, again=2)
    assert world.asked == [(12.0, (0.5, 0.8)), (24.0, (0.5,)), (48.0, (0.5,))]
    assert sorted(one.schedule.commands[0].vx for one in good) == [0.5, 0.8] and not any(one.apart for one in good)
    assert len(vain) == 2 and all(one.apart for one in vain)  # they were walked, so they count as robot time


def test_what_is_still_apart_stays_to_be_refused(monkeypatch):
    world, good, _ = held(monkeypatch, again=1)
    assert world.asked[-1] == (24.0, (0.5,)) and any(one.apart for one in good)
    assert held(monkeypatch, again=0)[0].asked == [(12.0, (0.5, 0.8))]


def test_each_try_is_asked_for_as_another_session(monkeypatch):
    world, _, _ = held(monkeypatch, again=4, until=1000.0)
    assert len({json.dumps(one, sort_keys=True) for one in world.named}) == 5  # two of them trim equally long


def test_trimming_ends_at_four_times_the_first_one(monkeypatch):
    world, good, vain = held(monkeypatch, again=4, until=1000.0)
    assert [seconds for seconds, _ in world.asked] == [12.0, 24.0, 48.0, 48.0, 48.0] and len(vain) == 4
    assert [one.apart for one in good] == [False, True]  # the last try stands, to be refused
