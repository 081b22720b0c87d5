"""How far a speed wanders slowly: what lasts counts, what does not drops out, and both kinds of data give the same."""

from __future__ import annotations

import numpy as np
import pytest

from hts.channels import Channel
from hts.contracts import VELOCITY
from hts.evaluation.simulation import SimulatedTrial
from hts.evaluation.wandering import Wandered, measured, of_pieces, simulated
from hts.recordings.recording import Series
from hts.testing.made_up_recordings import known_recording

RATE = 50.0


def block(speed, asked=0.5, held=True, fell=False, session="one"):
    """A block of a head-to-head whose forward speed is `speed`, (T,), at 50 Hz."""
    velocity = np.zeros((len(speed), 3))
    velocity[:, 0] = speed
    made = known_recording([1.0] * 20, rate_hz=RATE, vx=asked)
    return made.replace(
        channels={"base_velocity": Series(Channel("base_velocity", "m/s", (3,)), velocity)},
        fell=fell,
        session=session,
        notes={"held_command": "0.6"} if held else {},
    )


def test_an_error_that_stays_counts_whole_and_relative_to_the_speed():
    assert of_pieces(np.full((8, 3), 0.05), 0.5) == pytest.approx(0.01)


def test_errors_of_one_piece_drop_out_and_alternate_ones_are_not_taken_for_slow():
    noise = np.random.default_rng(3).normal(0.0, 0.1, (4000, 1))
    assert abs(of_pieces(noise, 1.0)) < 0.001 < noise.var()


def test_too_few_pieces_say_nothing():
    assert np.isnan(of_pieces(np.zeros((2, 4)), 0.5)) and np.isnan(of_pieces(np.zeros((8, 0)), 0.5))


def test_blocks_at_a_speed_are_taken_together_and_a_sensors_noise_drops_out():
    rng = np.random.default_rng(0)
    slow = [0.5 + offset + rng.normal(0.0, 0.4, 20 * 50) for offset in (0.03, -0.04) for _ in range(200)]
    found = measured([block(speed) for speed in slow], VELOCITY)
    assert found == {0.5: Wandered(pytest.approx((0.03**2 + 0.04**2) / 2 / 0.25, rel=0.1), 1)}


def test_each_speed_has_its_own_and_blocks_that_fell_or_were_not_held_say_nothing():
    constant = np.full(1000, 0.55)
    blocks = [block(constant), block(constant, asked=0.8), block(np.full(1000, 0.9), held=False, session="two")]
    found = measured([*blocks, block(np.full(1000, 0.1), fell=True, session="three")], VELOCITY)
    assert found == {
        0.5: Wandered(pytest.approx(0.01, rel=1e-4), 1),
        0.8: Wandered(pytest.approx((0.25 / 0.8) ** 2, rel=1e-4), 1),
    }
    more = [block(constant, session="four"), block(constant, session="four")]
    assert measured([*blocks, *more], VELOCITY)[0.5].sessions == 2
    assert measured([block(constant, held=False)], VELOCITY) == {}


def test_of_simulated_trials_each_instance_is_a_stretch_and_the_fallen_are_left_out():
    speeds = np.array([[0.55, 0.45]] * 6)  # (S, n): two instances, each off by its own constant error
    trial = SimulatedTrial(0.5, worlds=3, falls=1, mean_speed=0.5, valid=1.0, piece_speed=speeds.flatten())
    assert simulated([trial]) == {0.5: pytest.approx(0.01)}
    fallen = SimulatedTrial(0.5, worlds=2, falls=2, mean_speed=float("nan"), valid=0.0, piece_speed=np.empty(0))
    assert np.isnan(simulated([fallen])[0.5])
