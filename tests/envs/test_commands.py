"""Commanded velocities: ranges, standing, straight walks, heading control, fixed test speeds."""

from __future__ import annotations

import math

import pytest
import torch

from hts.config import CommandConfig
from hts.envs.commands import DRAWS, Commands

CPU = torch.device("cpu")


def commands(shape=(1, 4), **changes) -> Commands:
    return Commands(CommandConfig(**{"vx": (-1.0, 1.5), **changes}), shape, 0.02, CPU)


def drawn(shape, vx=0.9, vy=0.5, heading=0.5, yaw_rate=0.5, straight=0.99, stand=0.99, when=0.5) -> torch.Tensor:
    """The same uniform numbers for every world; 0.5 is the middle of a range."""
    return torch.tensor([vx, vy, heading, yaw_rate, straight, stand, when]).expand(*shape, DRAWS)


def everywhere(shape) -> torch.Tensor:
    return torch.ones(shape, dtype=torch.bool)


def resampled(made: Commands, yaw: float = 0.0, mask=None, **draws) -> Commands:
    shape = made.value.shape[:2]
    made.resample(everywhere(shape) if mask is None else mask, drawn(shape, **draws), torch.full(shape, yaw))
    return made


def test_uniform_numbers_become_speeds_in_the_range():
    made = resampled(commands(heading=False), vx=0.8, vy=0.75, yaw_rate=0.25)
    # -1 + 2.5 x 0.8, -0.5 + 1 x 0.75, -1 + 2 x 0.25
    torch.testing.assert_close(made.value[0, 0], torch.tensor([1.0, 0.25, -0.5]))


def test_below_a_fifth_of_a_metre_per_second_the_robot_is_told_to_stand():
    made = resampled(commands(heading=False), vx=0.46, vy=0.5, yaw_rate=1.0)  # vx = 0.15
    assert not made.value.any()


def test_a_slower_robot_walks_and_is_held_at_slower_commands_where_its_settings_say_so():
    slow = {"vx": (0.0, 0.3), "heading": False}
    made = resampled(commands(**slow, stand_below=0.1, held_from=0.12), vx=0.5, vy=0.5)
    torch.testing.assert_close(made.value[0, :, 0], torch.full((4,), 0.15))
    forward, seconds = torch.full((1, 4), 0.12), torch.full((1, 4), 2.0)
    torch.testing.assert_close(made.speed_error(forward, seconds), torch.full((1, 4), -0.2))
    by_default = commands(**slow)
    by_default.value[..., 0] = 0.15
    assert not by_default.speed_error(forward, seconds).any()
    assert not resampled(by_default, vx=0.5, vy=0.5).value.any()


def test_a_share_of_the_worlds_stands():
    assert not resampled(commands(stand=0.1, heading=False), stand=0.09).value.any()
    assert resampled(commands(stand=0.1, heading=False), stand=0.11).value.any()


def test_a_share_of_the_worlds_walks_straight_on():
    made = resampled(commands(straight=0.3, heading=False), straight=0.2, vy=1.0, yaw=0.7)
    assert made.value[0, 0, 1] == 0.0 and made.keeps_heading.all()
    torch.testing.assert_close(made.heading, torch.full((1, 4), 0.7))


def test_heading_control_turns_by_half_the_error():
    made = resampled(commands(), heading=0.5)  # the target heading is 0 rad
    made.steer(torch.tensor([[0.4, -0.4, 0.0, 3.0]]))
    torch.testing.assert_close(made.value[0, :, 2], torch.tensor([-0.2, 0.2, 0.0, -1.0]))  # clipped at 1 rad/s


def test_heading_control_takes_the_short_way_round():
    made = resampled(commands(), heading=1.0)  # pi
    made.steer(torch.full((1, 4), -math.pi + 0.2))
    torch.testing.assert_close(made.value[..., 2], torch.full((1, 4), -0.1))


def test_without_heading_control_the_yaw_rate_stays_as_drawn():
    made = resampled(commands(heading=False), yaw_rate=0.75)
    made.steer(torch.full((1, 4), 1.0))
    torch.testing.assert_close(made.value[..., 2], torch.full((1, 4), 0.5))


def test_test_speeds_are_dealt_out_in_turn_and_held_for_good():
    made = resampled(commands((2, 5), fixed=(0.5, 0.8)), yaw=0.3)
    expected = torch.tensor([0.5, 0.8, 0.5, 0.8, 0.5]).expand(2, 5)
    torch.testing.assert_close(made.value[..., 0], expected)
    for _ in range(5000):
        made.advance(drawn((2, 5)), torch.full((2, 5), 0.3), torch.zeros(2, 5))
    torch.testing.assert_close(made.value[..., 0], expected)
    assert not made.value[..., 1:].any()  # straight ahead, and already on its heading


def test_only_worlds_of_the_mask_get_a_new_command():
    made = resampled(commands(heading=False))
    before = made.value.clone()
    resampled(made, mask=torch.tensor([[True, False, False, True]]), vx=0.0)
    assert torch.equal(made.value[0, 1:3], before[0, 1:3])
    assert (made.value[0, [0, 3], 0] == -1.0).all()


@pytest.mark.parametrize(("when", "steps"), [(0.0, 250), (0.5, 500)])
def test_commands_change_after_half_to_one_and_a_half_times_the_interval(when, steps):
    made = resampled(commands(heading=False), when=when)
    for _ in range(steps - 1):
        made.advance(drawn((1, 4), vx=0.0), torch.zeros(1, 4), torch.zeros(1, 4))
    assert (made.value[..., 0] == 1.25).all()
    made.advance(drawn((1, 4), vx=0.0), torch.zeros(1, 4), torch.zeros(1, 4))
    assert (made.value[..., 0] == -1.0).all()


def test_commands_go_on_from_a_saved_state():
    made = resampled(commands())
    saved = made.state_dict()
    other = commands()
    other.load_state_dict(saved)
    for both in (made, other):
        both.advance(drawn((1, 4), vx=0.1), torch.full((1, 4), 0.2), torch.zeros(1, 4))
    for name, value in made.state_dict().items():
        assert torch.equal(value, other.state_dict()[name]), name


def test_the_error_of_a_robot_that_walks_backwards_is_a_share_of_what_it_was_told_too():
    made = commands(shape=(1, 4), held_from=0.3)
    made.value[..., 0] = torch.tensor([-0.5, -0.5, 0.5, -0.2])  # the last one is too slow to tell a share
    walked = torch.tensor([[-0.4, -0.6, 0.6, -0.1]])
    found = made.speed_error(walked, torch.full((1, 4), 2.0))
    torch.testing.assert_close(found, torch.tensor([[-0.2, 0.2, 0.2, 0.0]]))
    assert not made.speed_error(walked, torch.full((1, 4), 0.9)).any()  # still getting going
