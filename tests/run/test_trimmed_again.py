"""A final, or a trial, at held speeds is trimmed again where policy and reference ended apart."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace

import pytest

from hts.config import Command, EvaluationConfig, ScheduleConfig, SelectionConfig
from hts.contracts import HoldSpeed
from hts.evaluation.evaluate import evaluate_run
from hts.evaluation.walked_again import walked_again
from hts.recordings.recording import Series
from hts.run import algorithm, head_to_head, testing_elites
from hts.testing.known_world import KnownWorld
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run


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
                role=role,
                robot_samples=round(50 * self.hold.seconds),
                apart=speed == 0.5 and self.hold.seconds < self.until,
            )
            for speed in speeds
            for role in ("policy", "reference")
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
        check_recordings=lambda recordings: None,
    )

    def apart(objective, recordings, config, seed, task):
        return sorted({one.schedule.commands[0].vx for one in recordings if one.apart})

    monkeypatch.setattr(head_to_head, "speeds_missed", apart)
    return world, *head_to_head.held_head_to_head(job, "best", HoldSpeed((0.2, 1.5), 12.0, 0.01))


def test_only_the_speed_that_ended_apart_is_done_again_and_longer_each_time(monkeypatch):
    world, good, vain = held(monkeypatch, again=2)
    assert world.asked == [(12.0, (0.5, 0.8)), (24.0, (0.5,)), (48.0, (0.5,))]
    walked = sorted((one.schedule.commands[0].vx, one.role) for one in good)
    assert walked == [(speed, role) for speed in (0.5, 0.8) for role in ("policy", "reference")]
    assert not any(one.apart for one in good)
    assert len(vain) == 4 and all(one.apart for one in vain)  # they were walked, so they count as robot time


def test_what_is_still_apart_stays_to_be_refused(monkeypatch):
    world, good, _ = held(monkeypatch, again=1)
    assert world.asked[-1] == (24.0, (0.5,)) and any(one.apart for one in good)
    assert held(monkeypatch, again=0)[0].asked == [(12.0, (0.5, 0.8))]


def test_each_try_is_asked_for_as_another_session(monkeypatch):
    world, _, _ = held(monkeypatch, again=4, until=1000.0)
    assert len({json.dumps(one, sort_keys=True) for one in world.named}) == 5  # two of them trim equally long


def test_trimming_ends_at_four_times_the_first_one(monkeypatch):
    world, good, vain = held(monkeypatch, again=4, until=1000.0)
    assert [seconds for seconds, _ in world.asked] == [12.0, 24.0, 48.0, 48.0, 48.0] and len(vain) == 8
    assert [one.apart for one in good] == [False, False, True, True]  # the last try stands, to be refused


@pytest.mark.parametrize(("room", "tries"), [(2399, 0), (2400, 1), (7199, 1), (7200, 2), (math.inf, 2)])
def test_nothing_is_walked_again_that_does_not_fit_into_the_real_samples(room, tries):
    """12 s are 1,200 samples here, 24 s twice as many, and 48 s four times."""
    world = World(1000.0)

    def ask(hold, speeds):
        world.hold_speed(hold)
        return world.head_to_head("policy", "reference", speeds)

    def missed(recordings):
        return sorted({one.schedule.commands[0].vx for one in recordings if one.apart})

    hold = HoldSpeed((0.2, 1.5), 12.0)
    good, vain = walked_again(ask(hold, (0.5, 0.8)), hold, 2, missed, ask, room)
    assert (len(good), len(vain)) == (4, 2 * tries)


def test_tries_are_counted_on_and_what_was_walked_in_vain_is_told_apart():
    """Asked for the second time already, 10 s long: two more are the third and the fourth, of 20 and 40 s. 0.5 m/s are
    found with 40 s, 0.8 m/s at once."""
    world, holds = World(40.0), []

    def ask(hold, speeds):
        holds.append((hold.seconds, hold.again, tuple(speeds)))
        world.hold_speed(hold)
        return world.head_to_head("policy", "reference", speeds)

    def missed(recordings):
        return sorted({one.schedule.commands[0].vx for one in recordings if one.apart})

    hold = HoldSpeed((0.2, 1.5), 10.0, again=2)
    first = ask(hold, (0.5, 0.8))
    good, vain = walked_again(first, hold, 2, missed, ask)
    assert holds[1:] == [(20.0, 3, (0.5,)), (40.0, 4, (0.5,))]
    assert good[:2] == first[2:] and [one.robot_samples for one in good] == [500, 500, 2000, 2000]
    assert vain[:2] == first[:2] and [one.robot_samples for one in vain] == [500, 500, 1000, 1000]
    assert walked_again(good, hold, 2, missed, ask) == (good, [])  # nothing is missed, nobody is asked
    assert walked_again(first, hold, 0, missed, ask) == (first, []) and len(holds) == 3


def too_fast_at_first(monkeypatch):
    """Every policy goes 20 % too fast the first time that 0.8 m/s are to be held."""
    plain = KnownWorld._recording

    def recording(self, policy, schedule, session, block, role, *rest, **given):
        found = plain(self, policy, schedule, session, block, role, *rest, **given)
        if role != "policy" or self._hold is None or self._hold.again or schedule.commands[0].vx != 0.8:
            return found
        walked = found.channels["base_velocity"]
        faster = Series(walked.channel, 1.2 * walked.values)
        return found.replace(channels={**found.channels, "base_velocity": faster})

    monkeypatch.setattr(KnownWorld, "_recording", recording)


def test_the_best_so_far_walks_a_speed_again_as_the_final_does(tmp_path, monkeypatch):
    too_fast_at_first(monkeypatch)
    trials, held_by = algorithm.test, []

    def noting(job, *rest):
        held_by.append(job.world._hold.again)
        return trials(job, *rest)

    monkeypatch.setattr(algorithm, "test", noting)

    def measured(name, tries):
        settings = {"iterations": 2, "evaluation.each_iteration": True, "evaluation.hold_speed": True}
        speeds = {"evaluation.speeds": [0.5, 0.8], "selection.speeds": [0.5], "evaluation.trims_again": tries}
        with kit_installed():
            run = tiny_run(tmp_path / name, settings=settings | speeds)
        return run.summary["final"]["objectives"]["fake"], [row["measured_best"] for row in run.summary["iterations"]]

    _, (once, *_) = measured("once", 0)
    final, (first, *later) = measured("again", 1)
    assert list(once["objectives"]["fake"]["refused"]) == ["0.8"]
    assert not first["objectives"]["fake"]["refused"]
    assert first["uncounted"] == once["uncounted"] * 3 // 2  # one speed of two, once more
    assert all(not row["objectives"]["fake"]["refused"] for row in later)
    assert set(first["objectives"]["fake"]["speeds"]) == set(final["speeds"]) == {"0.5", "0.8"}
    assert held_by == [0] * 4  # the next trials are not held as the last try was


def test_a_trial_walks_a_speed_again_whose_command_was_not_found(tmp_path, monkeypatch):
    too_fast_at_first(monkeypatch)
    settings = {
        "sweep.kl_bounds": [0.5, 1.0],
        "selection.speeds": [0.5, 0.8],
        "selection.block_seconds": 10.0,
        "evaluation.hold_speed": True,
        "evaluation.speeds": [0.5],
    }

    def trials(name, tries):
        with kit_installed():
            run = tiny_run(tmp_path / name, settings=settings | {"selection.trims_again": tries})
        return json.loads((run.folder / "iterations/00/test.json").read_text())

    once, again = trials("once", 0), trials("again", 1)
    assert [row["refusal"]["speed"] for row in once["results"].values()] == [0.8] * len(once["elites"])
    assert not any(row["refused"] for row in again["results"].values())
    assert again["samples"] == once["samples"] * 3 // 2  # one speed of two, once more
    assert len(again["recordings"]) == len(once["recordings"]) * 3 // 2  # what was in vain is kept


@pytest.mark.parametrize(
    ("most", "walked"), [(599, []), (600, ["a"]), (749, ["a"]), (750, ["a", "b"]), (None, ["a", "b"])]
)
def test_second_tries_of_trials_stay_within_the_real_samples(monkeypatch, most, walked):
    """Two elites of two blocks, 100 samples each, one missed; walked again, trimmed longer, it takes 150."""

    def block(speed, samples, missed):
        schedule = ScheduleConfig(commands=(Command(seconds=20.0, vx=speed),))
        return SimpleNamespace(schedule=schedule, robot_samples=samples, missed=missed)

    asked = []

    def head_to_heads(job, elites, speeds):
        asked.extend(elites)
        return [[block(speed, 150, False) for speed in speeds] for _ in elites]

    def missed(objective, recordings, config, seed, task):
        return [one.schedule.commands[0].vx for one in recordings if one.missed]

    monkeypatch.setattr(testing_elites, "_head_to_heads", head_to_heads)
    monkeypatch.setattr(testing_elites, "speeds_missed", missed)
    job = SimpleNamespace(
        world=World(0.0),
        config=SimpleNamespace(
            evaluation=EvaluationConfig(), selection=SelectionConfig(trims_again=1), max_real_samples=most
        ),
        hold=HoldSpeed((0.2, 1.5)),
        objectives={"power": None},
        robot=SimpleNamespace(task=lambda: None),
        seed=lambda *what: 0,
    )
    of = {elite: [block(0.5, 100, False), block(0.8, 100, True)] for elite in "ab"}
    vain = testing_elites._again(job, of, spent=0)
    assert asked == walked and len(vain) == len(walked) and job.world.hold == job.hold
    assert [sum(one.robot_samples for one in row) for row in of.values()] == [
        250 if one in walked else 200 for one in of
    ]


def test_a_speed_missed_in_both_trials_is_walked_in_two_sessions(tmp_path, monkeypatch):
    """A world knows a request by its content: the same one again would be the recordings of the first trial."""
    too_fast_at_first(monkeypatch)
    asked, plain = [], KnownWorld.head_to_heads_in_session

    def session(self, policies, reference, speeds, block_seconds):
        asked.append((tuple(policy.stem for policy in policies), tuple(speeds), json.dumps(self._hold.named())))
        return plain(self, policies, reference, speeds, block_seconds)

    monkeypatch.setattr(KnownWorld, "head_to_heads_in_session", session)
    settings = {
        "iterations": 2,
        "sweep.kl_bounds": [0.5, 1.0],
        "selection.elites": 2,
        "selection.speeds": [0.5, 0.8],
        "selection.block_seconds": 10.0,
        "selection.trims_again": 1,
        "selection.confirm": 2,
        "evaluation.hold_speed": True,
        "evaluation.speeds": [0.5],
    }
    with kit_installed():
        run = tiny_run(tmp_path / "run", settings=settings)
    twice = json.loads((run.folder / "confirm.json").read_text())["tried"]
    alone = [request for request in asked if request[1] == (0.8,)]
    assert len(twice) == 2 and all(sum(names == (one,) for names, _, _ in alone) == 2 for one in twice)
    assert len(set(asked)) == len(asked)


def test_evaluating_afterwards_walks_a_speed_again_as_the_final_does(tmp_path, monkeypatch):
    too_fast_at_first(monkeypatch)
    settings = {"evaluation.hold_speed": True, "evaluation.speeds": [0.5, 0.8], "evaluation.trims_again": 1}
    with kit_installed():
        run = tiny_run(tmp_path / "run", settings=settings)
        found = evaluate_run(run.folder)
        once = evaluate_run(run.folder, speeds=[0.5])
    assert set(found["objectives"]["fake"]["speeds"]) == {"0.5", "0.8"}
    assert "refused" not in found["objectives"]["fake"]
    assert len(found["recordings"]) == len(once["recordings"]) // 2 * 5  # 0.8 m/s held twice; what was in vain is kept


def test_evaluating_at_equal_commands_refuses_one_speed_alone_as_the_final_does(tmp_path, monkeypatch):
    with kit_installed():
        run = tiny_run(tmp_path / "run", settings={"evaluation.speeds": [0.5, 0.8]})
        plain = KnownWorld._recording

        def recording(self, policy, schedule, session, block, role, *rest, **given):
            found = plain(self, policy, schedule, session, block, role, *rest, **given)
            if role != "policy" or schedule.commands[0].vx != 0.8:
                return found
            walked = found.channels["base_velocity"]
            return found.replace(
                channels={**found.channels, "base_velocity": Series(walked.channel, 2 * walked.values)}
            )

        monkeypatch.setattr(KnownWorld, "_recording", recording)
        found = evaluate_run(run.folder)["objectives"]["fake"]
    assert list(found["speeds"]) == ["0.5"] and list(found["refused"]) == ["0.8"]
