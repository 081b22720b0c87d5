"""Held-out samples that are fitted to as well are found, and taken out of the fit."""

import numpy as np

from hts.measurement.shared import shared_samples, without_shared
from hts.measurement.split import named_part
from hts.recordings.recording import Series
from hts.testing.known_signals import HEAT, known_heat

CHANNELS = ("effort", "rate", "heat")


def test_a_move_cut_from_the_run_it_is_held_against_is_taken_out_of_the_run():
    run = known_heat(1, id="run")
    move = named_part(run, 300, 400).replace(id="move")
    kept, found = without_shared([run], [move], CHANNELS)
    assert [one.id for one in kept] == ["run[0:275]", "run[425:1000]"]  # half a second on each side goes too
    assert (found.held_out, found.of, found.removed) == (100, 100, 150)


def test_recordings_of_the_same_gait_share_nothing():
    kept, found = without_shared([known_heat(1, id="a")], [known_heat(2, id="b")], CHANNELS)
    assert [one.id for one in kept] == ["a"] and (found.held_out, found.removed) == (0, 0)


def test_the_last_digits_may_differ_as_after_resampling():
    run = known_heat(1, id="run")
    move = named_part(run, 300, 400)
    off = move.values("heat") + 1e-6 * np.random.default_rng(0).normal(size=100)
    move = move.replace(channels={**move.channels, "heat": Series(HEAT, off)})
    in_run, in_move = shared_samples([run], [move], CHANNELS)
    assert in_move[0].sum() >= 95 and abs(int(in_run[0].sum()) - int(in_move[0].sum())) <= 5


def test_standing_still_twice_is_not_the_same_log():
    still = known_heat(1, seconds=4.0)
    channels = {name: Series(s.channel, np.ones_like(s.values)) for name, s in still.channels.items()}
    still = still.replace(channels=channels, id="still")
    assert without_shared([still, known_heat(2, id="w")], [still], CHANNELS)[1].held_out == 0


def test_the_same_store_on_both_sides_leaves_nothing():
    run = known_heat(1, id="run")
    kept, found = without_shared([run], [run], CHANNELS)
    assert kept == [] and found.held_out == 1000


def test_parts_shorter_than_a_second_are_dropped():
    run = known_heat(1, id="run")
    kept, found = without_shared([run], [named_part(run, 60, 960)], CHANNELS)
    assert kept == [] and found.removed == 1000
