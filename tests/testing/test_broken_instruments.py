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


@pytest.mark.parametrize("body", ["", SLOW])
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
