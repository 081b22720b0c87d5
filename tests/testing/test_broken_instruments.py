"""Instruments with one fault each: the kit names it, in one line; slow and noisy ones have none."""

from __future__ import annotations

import pytest

from hts.plugins import load
from hts.testing.conformance import check_package
from hts.testing.packages import on_path

SOURCE = """
from hts import hookimpl

HTS_API = 2


def make(settings, robot):
    import numpy as np
    from hts.testing.examples.instrument.instrument import CHANNEL, Settings, Warmth

    class Odd(Warmth):
        '''Sound, but for what a test changes.'''
{body}

    return Odd(Settings(**settings))


@hookimpl
def hts_instruments(register):
    register("odd", make)
"""

SLOW = """
        def read(self):
            return {CHANNEL.name: np.rint(self.kelvin)}
"""  # shows no change within the first seconds


def faults(install, body: str) -> list[str]:
    """Lines of everything that is not kept; body: indented by 8 in front, methods of the instrument."""
    with on_path(install("odd-lab", {"odd_lab": SOURCE.format(body=body)}, {"odd": "odd_lab"})):
        return [finding.line() for finding in check_package(load(), "odd-lab") if finding.fault is not None]


OFFSETS = """
        def reset(self, num_worlds, rng):
            super().reset(num_worlds, rng)
            self.offset = rng.normal(0, 1, num_worlds)

        def read(self):
            return {CHANNEL.name: 5 + self.offset + super().read()[CHANNEL.name]}

        def idle(self):
            return {CHANNEL.name: 5.0}
"""  # each robot's sensor has a zero error of its own, and one number is read off
COOLING = """
        def reset(self, num_worlds, rng):
            super().reset(num_worlds, rng)
            self.warm = np.full(num_worlds, 50.0)

        def step(self, sample):
            super().step(sample)
            self.warm = self.warm * (1 - sample.dt / 600)

        def read(self):
            return {CHANNEL.name: self.warm + super().read()[CHANNEL.name]}
"""  # still warm, and a minute is not enough
LATE = """
        def reset(self, num_worlds, rng):
            super().reset(num_worlds, rng)
            self.shown = np.zeros(num_worlds)

        def step(self, sample):
            super().step(sample)
            self.shown = self.shown + sample.dt / 2.0 * (30 + self.kelvin - self.shown)

        def read(self):
            return {CHANNEL.name: self.shown.copy()}

        def idle(self):
            return {CHANNEL.name: 30.0}
"""  # begins at 0 and comes to its level within seconds
WHOLE_TENS = """
        def read(self):
            return {CHANNEL.name: 10 * np.rint((4 + 20 * self.kelvin) / 10)}

        def idle(self):
            return {CHANNEL.name: 4.0}
"""  # a level of 4 reads 0
SCALES = """
        def step(self, sample):
            super().step(sample)
            self.weight = sample.foot_force.sum(axis=-1)

        def read(self):
            return {CHANNEL.name: self.weight + self.kelvin}

        def idle(self):
            return {CHANNEL.name: 120.0}
"""  # the robot's weight, which the made-up one does not have
COUNTS = """
        def reset(self, num_worlds, rng):
            super().reset(num_worlds, rng)
            self.joules = np.zeros(num_worlds)

        def step(self, sample):
            super().step(sample)
            self.joules = self.joules + sample.dt * (3 + self.kelvin)

        def read(self):
            return {CHANNEL.name: self.joules.copy()}
"""  # begins at its level and leaves it
ENABLED = """
        idles_at_rest = False

        def read(self):
            return {CHANNEL.name: 38 + self.kelvin}

        def idle(self):
            return {CHANNEL.name: 30.0}
"""  # inverters take 8 W once they are on


@pytest.mark.parametrize("body", ["", SLOW, OFFSETS, COOLING, LATE, WHOLE_TENS, SCALES, COUNTS, ENABLED])
def test_a_sound_instrument_passes(install, body):
    assert faults(install, body) == []


def method(signature: str, *lines: str) -> str:
    return f"\n        def {signature}:\n" + "".join(f"            {line}\n" for line in lines)


@pytest.mark.parametrize(
    ("body", "fault"),
    [
        (method("advance(self, samples)", "pass"), "'warmth_reading' after advance() of 20 steps is off by up to"),
        (
            method("advance(self, samples)", "for one in range(19):", "    self.step(samples.at(one))"),
            "'warmth_reading' after advance() of 20 steps is off by up to",
        ),
        (
            method("advance(self, samples)", "super().advance(samples)", "samples.motor_torque[:] = 0"),
            "advance() changes motor_torque in place",
        ),
        (
            method("idle(self)", "return {CHANNEL.name: 3.0}"),
            "idle() gives 3 for 'warmth_reading', with motors off and nothing moving it reads ",
        ),
        (
            method(
                "read(self)",
                "return {CHANNEL.name: 2 + self.kelvin + 0.1 * self.rng.standard_normal(self.kelvin.shape)}",
            ),
            "idle() gives 0 for 'warmth_reading', with motors off and nothing moving it reads ",
        ),
        (
            "\n        from hts.channels import Channel"
            "\n        channels = (Channel(CHANNEL.name, 'K', (2,)),)\n"
            + method("read(self)", "return {CHANNEL.name: np.stack([2 + self.kelvin, 3 + self.kelvin], -1)}"),
            "idle() gives 0 for 'warmth_reading', with motors off and nothing moving it reads 2.5",
        ),
        (method("step(self, sample)", "pass"), "reads of 60 s of motion what it reads of robots at rest"),
        (method("settle(self)", "self.kelvin = self.kelvin * np.nan"), "after settle() 'warmth_reading' is not finite"),
        (
            method("settle(self)", "self.kelvin = np.full_like(self.kelvin, self.heat.mean())"),
            "after settle() 'warmth_reading' of a robot depends on the robots beside it",
        ),
        (
            method("read(self)", "return {CHANNEL.name: self.kelvin + 0.02 * self.rng.standard_normal(3)}"),
            "'warmth_reading' has shape (3,) for 1 robot, not (1,)",
        ),
    ],
)
def test_a_faulty_instrument_is_named_with_its_fault(install, body, fault):
    found = faults(install, body)
    print(*found, sep="\n")
    assert any(line.startswith(f"odd-lab: instrument 'odd': {fault}") for line in found), found
    assert all("\n" not in line for line in found)
