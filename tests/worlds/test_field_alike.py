"""The world `field`: what is measured in rows of one comparison is held against each other."""

from __future__ import annotations

import numpy as np
import pytest
from field_folder import bundle, field, fill_in, write_log

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.errors import WaitingForRobot
from hts.recordings.doubts import remarks
from hts.recordings.recording import Recording, Series
from hts.worlds.field_alike import NOTE, with_alike_blocks

ROLES = ("reference", "policy", "policy", "reference")
NAMES = ("00", "01", "02", "03")


def rows(levels, channel="draw", unit="A", idle=1.0, roles=ROLES):
    """Blocks of one session whose channel has these means."""
    schedule, swing, time = (
        ScheduleConfig(commands=(Command(seconds=2.0, vx=0.5),)),
        np.tile([-0.1, 0.1], 50),
        np.arange(100) / 50,
    )
    made = []
    for level, role in zip(levels, roles, strict=True):
        channels = {channel: Series(Channel(channel, unit), level + swing)}
        facts = {
            "idle": {channel: idle},
            "clock": "log",
            "time": time,
            "channels": channels,
            "session": "s",
            "role": role,
        }
        made.append(Recording("walker", "field", "", 0, ("hip",), (0.0,), (0.0,), 50, schedule, **facts))
    return made


def told(recordings):
    return [line for line in remarks(with_alike_blocks(recordings, NAMES)) if NOTE in line]


@pytest.mark.parametrize(
    ("levels", "idle", "unit", "said"),
    [
        ([4.5, 4.6, 46.0, 4.5], 1.3, "A", "4.6 A in the mean of row 01 and 46 A in row 02, both of the policy: "),
        ([4.5, 4.6, 6.4, 4.5], 1.3, "A", "4.6 A in the mean of row 01 and 6.4 A in row 02, both of the policy: "),
        ([4.5, 46.0, 46.0, 4.5], 1.3, "A", "4.5 A in the mean of row 00 and 46 A in row 01, of reference and policy: "),
        ([22.0, 22.0, 24.2, 24.2], 22.5, "V", "22 V in the mean of row 00 and 24.2 V in row 03, both of the reference"),
        ([22.0, 24.2, 24.2, 22.0], 22.5, "V", "22 V in the mean of row 00 and 24.2 V in row 01, of reference and "),
    ],
)
def test_blocks_that_are_far_apart_are_told_with_both_rows(levels, idle, unit, said):
    (line,) = told(rows(levels, unit=unit, idle=idle))
    begin = "note: blocks_unlike of 4 of 4 recordings, the first a recording: session s: 'draw' is "
    assert line.startswith(begin + said)


@pytest.mark.parametrize(
    ("levels", "idle", "unit"),
    [
        ([4.5, 2.5, 2.4, 4.4], 1.3, "A"),  # two thirds saved
        ([22.8, 22.6, 22.3, 22.1], 23.5, "V"),  # a pack that empties
        ([30.0, 45.0, 60.0, 70.0], 25.0, "degC"),  # a motor that warms up
        ([0.0, 0.0, 0.0, 0.0], 0.0, "A"),
    ],
)
def test_savings_a_pack_that_empties_and_heat_are_not(levels, idle, unit):
    assert told(rows(levels, unit=unit, idle=idle)) == []


def test_falls_and_other_sessions_say_nothing():
    made = rows([4.5, 4.6, 46.0, 4.5], idle=1.3)
    assert told([*made[:2], made[2].replace(fell=True), made[3]]) == []
    assert told([*made[:2], made[2].replace(session="t"), made[3]]) == []
    assert told([one.replace(role="collection") for one in made]) == []


def test_logs_of_a_bundle_are_looked_at_so(run, policy, robot):
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(policy, policy, [0.8])
    fill_in(run)
    for row in NAMES:
        log = bundle(run) / "logs" / f"{row}.csv"
        write_log(log, robot)
        if row == "02":  # the column before the last one
            head, *lines = log.read_text().splitlines()
            assert head.endswith(",battery_current")
            log.write_text(
                "\n".join([head, *(f"{line.rpartition(',')[0]},{30 + n % 2}" for n, line in enumerate(lines))])
            )
    assert len([line for line in remarks(field(run).head_to_head(policy, policy, [0.8])) if NOTE in line]) == 1
