"""What is expected of a drive's weights before any data: textbook values, and how far drives are from them.

The unit is the weight of mechanical power that a drive does, 1; what one unit is in a gauge's amperes is free. Normal
distributions, with a part that all joints share, one that joints of one kind share, and one of each joint:

- copper loss: r/k², W/(N m)², is the published 0.3 (`hts_power.proxy`), for all joints. Other motors and other gears
  make another one (it goes with the square of the gear ratio: a stage of 1.5 : 1 more is a factor of 2.25), so it may
  well be half off in all, and two thirds more between kinds, or a quarter where the gears are told. Windings of one
  type differ by 5 to 10 %;
- mechanical power that is done: 1, to a few per cent, which a converter loses; there is no other way to do work;
- what is generated: used in full, burnt, or anything between (uniform on 0 to 1 has the mean 0.5 and deviation 0.29);
- inverter loss |tau|, iron loss |q'| and q'^2, saturation tau^4: none is expected, and not more of them in all of a
  log than shares of the copper loss.

Every share says an order of magnitude; copper's and the losses' were settled on eight development realities,
that of kinds whose gears are told on nine.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hts_power.proxy import JOULE_COEFFICIENT

COPPER = (0.5, 0.67, 0.13)  # deviation of the common part, of a kind's, of a joint's; shares of r/k²
GEARED_KIND = 0.25  # in the place of a kind's, where gears are told; motors and gears of other builds are left
DONE = (0.05, 0.02, 0.03)  # of mechanical power that is done
GENERATED = (0.29, 0.03, 0.03)  # of what is generated: one bus, so hardly a joint's own
LOSSES = {"torque": 0.05, "speed": 0.02, "speed_squared": 0.02, "torque_fourth": 0.1}  # shares of the copper loss
LOSS_OF_KIND, LOSS_OF_JOINT = 0.7, 0.15  # of these
ANYTHING = 10.0  # times the deviation, where nothing is expected of the copper loss
TERMS = 7  # per joint: tau^2, tau q', max(tau q', 0), |tau|, |q'|, q'^2, tau^4


class Expected(NamedTuple):
    """weight: mean (TERMS · J,), covariance: (TERMS · J, TERMS · J), of weights of terms that are scaled by size."""

    weight: np.ndarray
    covariance: np.ndarray


def kinds(names: Sequence[str], count: int) -> np.ndarray:
    """Which joints are built alike, (J,) numbers: FR_hip and FL_hip are, by what follows the leg's name.
    All are where names do not say."""
    rest = [name.split("_", 1)[-1] for name in names]
    if len(rest) != count or any(rest.count(one) < 2 for one in rest):
        return np.zeros(count, dtype=int)
    order = list(dict.fromkeys(rest))
    return np.array([order.index(one) for one in rest])


def expected(
    kind: np.ndarray, size: np.ndarray, joule_coefficient: float | None, gears: Sequence[float] | None = None
) -> Expected:
    """kind: of each joint, (J,); size: root mean square of each term in the log, (TERMS · J,), positive,
    alike for all joints; joule_coefficient: r/k², W/(N m)², of joints with the smallest gear ratio; None: nothing is
    known of it; gears: ratio of each joint, (J,), up to a factor; None: not told, and all joints are expected alike."""
    joints = len(kind)
    least = joule_coefficient or JOULE_COEFFICIENT
    copper = np.full(joints, least) if gears is None else least * np.square(min(gears) / np.array(gears))
    of_all, of_kind, own = COPPER if gears is None else (COPPER[0], GEARED_KIND, COPPER[2])
    wide = 1.0 if joule_coefficient else ANYTHING
    alike = (kind[:, None] == kind).astype(float)

    def spread(shared: float, of_a_kind: float, of_one: float) -> np.ndarray:
        return shared**2 + of_a_kind**2 * alike + of_one**2 * np.eye(joints)

    loss = least * size[0]  # scaled weight of the copper loss
    blocks = np.zeros((TERMS, joints, TERMS, joints))
    blocks[0, :, 0] = wide**2 * np.outer(copper, copper) * spread(of_all, of_kind, own)
    done, generated = spread(*DONE), spread(*GENERATED)
    # w of tau q' is what is generated, w of max(tau q', 0) is what is done less that.
    blocks[1, :, 1], blocks[2, :, 2] = generated, done + generated
    blocks[1, :, 2] = blocks[2, :, 1] = -generated
    for term, share in enumerate(LOSSES.values(), start=3):
        most = share * loss / size[term * joints]
        blocks[term, :, term] = most**2 * spread(1.0, LOSS_OF_KIND, LOSS_OF_JOINT)
    weight = np.concatenate([copper, np.repeat([0.5, 0.5, 0.0, 0.0, 0.0, 0.0], joints)]) * size
    return Expected(weight, blocks.reshape(TERMS * joints, TERMS * joints) * np.outer(size, size))
