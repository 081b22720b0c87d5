"""The replay of a log: does the imported policy do what the original did, and do its actions mean what is said?

Each item of `hts.policies.proof` is proven, refuted (PolicyError, with what the log shows instead), or left not proven
with the reason. From a log with, in each row k, what the network was given o_k, its action a_k, by joint name the
target sent u_k, angle q_k, speed dq_k and torque tau_k, and a stamp t_k:

    actions        network(o_k) = a_k
    order, scale   u_k = default + scale a_k, joint by joint, by name
    observation    each part of o_k is the measured quantity of row k or of the row before
    gains, delay   tau_k = kp (u_{k-L} - q_k) - kd dq_k for one lag L, which is the shortest that explains the torques
    control rate   from stamps, where actions change

The state that a_k came from is row k - O (O = 0 where state is read before the target is sent, 1 where it is logged
after); its target is felt at row k + L. Whatever the logger's order, L + O = 1 + floor(delay / row).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from hts.contracts import RobotSpec
from hts.errors import PolicyError
from hts.policies.contract import OF_JOINTS, Contract, known_joints, per_joint
from hts.policies.importing import Imported
from hts.policies.layers import FEWEST_EXAMPLES, TOLERANCE, actions_of, difference
from hts.policies.position_control import ALIKE, FEWEST, LONGEST_LAG, REFUTED, UNEXPLAINED, Fit, PositionControl
from hts.policies.proof import NOT_PROVEN, PROVEN, State, of_card
from hts.policies.replay_log import Log
from hts.policies.replay_observation import AXES, SEEN_TOLERANCE, relative
from hts.policies.replay_observation import explained as explained_part
from hts.policies.replay_targets import TARGET_TOLERANCE, explained

MOVES = 1e-3  # action units: an action that varies less shows nothing of its joint
RATE_TOLERANCE = 0.02
WORST_FACTOR = 1.05  # a lag counts as good as the best up to this factor of the residual


def replay(path: Path, imported: Imported, log: Log, robot: RobotSpec) -> dict[str, State]:
    """The states of all items after the log. Raises PolicyError for what the log refutes."""
    states = of_card(imported.policy.card.made)
    if imported.maps is None or imported.contract is None or imported.network is None:
        raise PolicyError(f"{path}: made by hts, so there is nothing to replay. Leave out --log.")
    contract = imported.contract.of_robot(robot)
    names = known_joints(path, contract, robot)
    seeing = _Replay(path, imported, log, robot, contract, names)
    # In this order: later ones go on from what earlier ones found, or say it better.
    found = seeing.control_rate() | seeing.targets() | seeing.actions() | seeing.observation() | seeing.torques()
    for item, state in found.items():
        differs = item in states and states[item].state not in (PROVEN, NOT_PROVEN)
        if not differs:  # that the log shows what the contract says does not make it the robot's
            states[item] = state
    return states


class _Replay:
    """One log against one imported policy. All arrays of joints in the source's order."""

    def __init__(
        self, path: Path, imported: Imported, log: Log, robot: RobotSpec, contract: Contract, names: tuple[str, ...]
    ) -> None:
        self.path, self.imported, self.log, self.robot, self.names = path, imported, log, robot, names
        self.contract = contract
        self.stated = imported.contract
        assert imported.maps is not None
        self.maps = imported.maps
        self._check_columns()
        self.given = log.observation
        values = {key: getattr(contract, key) for key in OF_JOINTS}
        self.pose, self.scale, self.kp, self.kd = (
            np.array(per_joint(path, key, value, names)) for key, value in values.items()
        )
        self.target, self.position, self.velocity, self.torque = (
            log.by_joint(what, names) for what in ("joint_target", "joint_position", "joint_velocity", "joint_torque")
        )
        self.action = log.action
        self.rebuilt = False
        if self.action is None and self.target is not None:
            self.action = (self.target - self.pose) / self.scale
        self.offset: int | None = None  # O
        self.asked = _changes(self.action)

    def _check_columns(self) -> None:
        """Raise PolicyError for a log of another policy or robot: of another width, or with other joints."""
        wanted = {"observation": len(self.maps.entry), "action": len(self.names)}
        for key, width in wanted.items():
            values = getattr(self.log, key)
            if values is not None and values.shape[1] != width:
                raise PolicyError(
                    f"{self.log.path}: '{key}' has {values.shape[1]} columns, the policy in {self.path} has {width}. "
                    "Replay a log of this policy, or correct its layout (--layout)."
                )
        missing = [name for name in self.names if name not in self.log.joint_names]
        if self.log.joint_names and missing:
            raise PolicyError(
                f"{self.log.path}: its joint_names {list(self.log.joint_names)[:12]} lack '{missing[0]}' of robot "
                f"'{self.robot.name}'. Name the columns as the robot calls its joints."
            )

    # -------------------------------------------------------------------------------------------- rate

    def control_rate(self) -> dict[str, State]:
        moving = self.log.action if self.log.action is not None else self.target
        if self.log.time is None or moving is None or len(moving) < FEWEST:
            return _open(
                "control_rate", "the log has no stamps" if self.log.time is None else "the log has too few rows"
            )
        changes = _changes(moving)
        if len(changes) < FEWEST:
            return _open("control_rate", "its actions hardly change")
        seconds = float(np.median(np.diff(self.log.time[changes])))
        rate, said = 1.0 / seconds, self.contract.control_rate_hz
        assert said is not None
        if abs(rate / said - 1.0) > RATE_TOLERANCE:
            raise self._refuted(
                f"its actions change {rate:.4g} times a second by the log's stamps, control_rate_hz says {said:g}"
            )
        return _shown("control_rate", f"actions change every {1e3 * seconds:.4g} ms by the log's stamps")

    # ----------------------------------------------------------------------------------------- targets

    def targets(self) -> dict[str, State]:
        items = ("joint_order", "action_scale", "default_pose")
        if self.target is None or self.log.action is None:
            why = "the log has no joint targets by name" if self.target is None else "the log has no actions"
            return _open(items, why)
        action, target = self.log.action, self.target
        if len(action) < FEWEST:
            return _open(items, f"the log has {len(action)} rows, expected {FEWEST}")
        still = [name for name, spread in zip(self.names, action.std(0), strict=True) if spread < MOVES]
        if still:
            return _open(items, f"the log hardly moves {still[0]}")
        off = np.abs(target - (self.pose + self.scale * action)).max(0)
        if np.all(off <= TARGET_TOLERANCE):
            why = f"{len(action)} targets are default pose + scale x action, by name, to {off.max():.1g} rad"
            return _shown(items, why)
        wrong = explained(self.names, self.pose, self.scale, action, target)
        if wrong:
            raise self._refuted(wrong)
        why = f"targets are not default pose + scale x action (off by {off.max():.2g} rad; filtered, or clipped?)"
        return _open(items, why)

    # ----------------------------------------------------------------------------------------- actions

    def actions(self) -> dict[str, State]:
        if self.action is None:
            return _open("actions", "the log has neither actions nor targets")
        if self.given is None:
            return self._rebuild()
        if not bool(self.maps.own.all()):
            return _open("actions", "a part that something stands in for differs from what the original saw")
        off = self._off(self.given, self.action)
        if not off <= TOLERANCE:
            if self.target is not None and self._off(self.given, self.target) <= TARGET_TOLERANCE:
                raise self._refuted(
                    "its network gives the joint targets themselves, rad, and not the actions that they are made of. "
                    "Export it without default pose and scale"
                )
            elu = self.imported.policy.card.made.get("kind") == "rsl_rl"  # the others say it themselves
            raise self._refuted(
                f"its actions are off by up to {off:.2g} from the log's. Is `observation` what the "
                "network was given, before its normaliser, and the action without noise"
                f"{', and was ELU its activation' if elu else ''}"
            )
        different = len(np.unique(self.given, axis=0))
        if different < FEWEST_EXAMPLES:
            return _open(
                "actions",
                f"different observations in the log's {len(self.given)} rows: {different}, expected at least "
                f"{FEWEST_EXAMPLES}",
            )
        return _shown("actions", f"{len(self.action)} actions replayed, off by at most {off:.1g}")

    def _off(self, given: np.ndarray, action: np.ndarray) -> float:
        size = sum(int(part["size"]) for part in self.imported.policy.card.observation)
        assert self.imported.network is not None
        ours = self.maps.to_ours(torch.from_numpy(given), size)
        mine = actions_of(self.imported.policy.tensors, len(self.imported.network.layers), ours)
        return difference(self.maps.action_to_source(mine), torch.from_numpy(action))

    def _rebuild(self) -> dict[str, State]:
        """Without logged observations: built from the measured quantities, by the layout."""
        whole = [self._built(offset) for offset in (0, 1)]
        if any(one is None for one in whole):
            return _open("actions", "the log has neither observations nor all that they are made of")
        assert self.action is not None
        offs = []
        for offset, one in enumerate(whole):
            given = one[self.asked]  # type: ignore[index]
            offs.append(self._off(given, self.action[self.asked]) if len(given) >= FEWEST else np.inf)
            if offs[-1] <= SEEN_TOLERANCE * 10:
                self.offset, self.given, self.rebuilt = offset, one, True
                how = "with observations built from the log's channels"
                why = f"{len(given)} actions replayed {how}, off by at most {offs[-1]:.1g}"
                if self.log.action is not None:
                    return _shown("actions", why)
                items = ("actions", "observation", "joint_order", "action_scale", "default_pose")
                return _shown(items, why)
        return _open(
            "actions",
            f"actions replayed with observations built from the log's channels are off by {min(offs):.2g}: another "
            "contract, or channels that are not what the policy saw (noise, filters)",
        )

    # ------------------------------------------------------------------------------------- observation

    def _part(self, name: str) -> np.ndarray | None:
        """What a part of ours is by the log's channels, in the source's joint order and our units."""
        if name in ("joint_position_offset", "joint_position"):
            return self.position
        if name == "joint_velocity":
            return self.velocity
        if name == "last_action":
            return None if self.action is None else np.vstack([np.zeros_like(self.action[:1]), self.action[:-1]])
        return self.log.vectors.get(name)

    def _expected(self, name: str, first: int, size: int, offset: int) -> np.ndarray | None:
        """What the network should have been given as that part, rows from 1."""
        value = self._part(name)
        if value is None or value.shape[1] != size:
            return None
        if name == "last_action":  # in the source's own units already
            return value * self.maps.factor[first : first + size].numpy()
        if name == "joint_position_offset":
            value = value - self.pose
        shifted = np.vstack([value[:1]] * offset + [value[: len(value) - offset]]) if offset else value
        if name == "command":  # what was asked of the policy in this row, whenever the state was read
            shifted = value
        return shifted * self.maps.factor[first : first + size].numpy()

    def _built(self, offset: int) -> np.ndarray | None:
        assert self.action is not None
        given = np.zeros((len(self.action), len(self.maps.entry)))
        for name, first, size in self.maps.parts:
            value = self._expected(name, first, size, offset)
            if value is None:
                return None
            given[:, first : first + size] = value
        return given

    def observation(self) -> dict[str, State]:
        if self.given is None:
            return _open("observation", "the log has no observations")
        if self.rebuilt:
            return _shown("observation", "built from the log's channels, it gives the log's actions")
        rows = self.asked
        if len(rows) < FEWEST:
            return _open("observation", "the log has too few rows in which its actions change")
        unknown, offsets = [], {}
        for name, first, size in self.maps.parts:
            seen = self.given[rows, first : first + size]
            fits = []
            for offset in (0, 1):
                expected = self._expected(name, first, size, offset)
                if expected is None:
                    break
                fits.append(relative(seen, expected[rows]))
            if not fits:
                unknown.append(name)
                continue
            good = [offset for offset, off in enumerate(fits) if off <= SEEN_TOLERANCE]
            if not good:
                for offset in np.argsort(fits):
                    self._explain_part(name, first, size, seen, int(offset))
                unknown.append(f"{name} (off by {min(fits):.2g})")
            elif len(good) == 1 and name.startswith("joint_"):
                offsets[name] = good[0]
        if len(set(offsets.values())) == 1:
            self.offset = next(iter(offsets.values()))
        if unknown:
            return _open("observation", f"the log does not show, or not as the layout says: {', '.join(unknown)}")
        return _shown("observation", f"{len(self.given)} observations are what the layout says of the log's channels")

    def _explain_part(self, name: str, first: int, size: int, seen: np.ndarray, offset: int) -> None:
        """Raises PolicyError if the part is exactly something else than the layout says."""
        expected = self._expected(name, first, size, offset)
        if expected is None or self.log.action is None:
            return
        factor = self.maps.factor[first : first + size].numpy()
        others = {}
        for other, at, width in self.maps.parts:
            if other != name and width == size and (values := self._expected(other, at, width, offset)) is not None:
                others[other] = (values / self.maps.factor[at : at + width].numpy())[self.asked]
        labels = self.names if size == len(self.names) else AXES
        if len(labels) == size and (
            wrong := explained_part(name, labels, seen, expected[self.asked], factor, self.pose, others)
        ):
            raise self._refuted(wrong)

    # ----------------------------------------------------------------------------------------- torques

    def torques(self) -> dict[str, State]:
        items = ("gains", "delay")
        held = (self.target, self.position, self.velocity, self.torque)
        if any(one is None for one in held):
            return _open(items, "the log has no joint torques with targets, angles and speeds")
        target, position, velocity, torque = (one for one in held if one is not None)
        if len(target) < FEWEST + LONGEST_LAG:
            return _open(items, f"the log has {len(target)} rows, expected {FEWEST + LONGEST_LAG}")
        control = PositionControl(self.names, target, position, velocity, torque, self.limit())
        fits = [control.fit(lag) for lag in range(LONGEST_LAG + 1)]
        left = np.array([fit.left.max() for fit in fits])
        lag = int(left.argmin())
        if left[lag] > UNEXPLAINED:
            share = f"{100 * left[lag]:.0f} % of the log's torques, expected at most {100 * UNEXPLAINED:.0f} %"
            return _open(items, f"position control leaves {share}")
        return self._gains(control, fits[lag]) | self._delay(lag, left)

    def limit(self) -> np.ndarray:
        """Largest torques, N·m."""
        own = dict(zip(self.robot.joint_names, self.robot.torque_limit, strict=True))
        return np.array([own[name] for name in self.names])

    def _gains(self, control: PositionControl, fit: Fit) -> dict[str, State]:
        said = control.left_by(self.kp, self.kd, fit.lag)
        wrong = np.flatnonzero(~control.alike(self.kp, self.kd, fit))
        if len(wrong):
            worst = int(wrong[said[wrong].argmax()])
            text = (
                f"of {self.names[worst]} kp {fit.kp[worst]:.4g} and kd {fit.kd[worst]:.4g} explain the log's torques "
                f"to {100 * fit.left[worst]:.1g} %, the contract's {self.kp[worst]:.4g} and {self.kd[worst]:.4g} to "
                f"{100 * said[worst]:.2g} %"
            )
            if said[worst] > max(REFUTED, ALIKE * fit.left[worst]):
                raise self._refuted(text)
            return _open("gains", text)
        unseen = control.unseen(self.kp, self.kd, fit.lag, said)
        if unseen:
            return _open("gains", f"another {unseen} would hardly change the log's torques")
        return _shown("gains", f"torques are kp (target - angle) - kd speed, to {100 * said.max():.1g} %")

    def _delay(self, lag: int, left: np.ndarray) -> dict[str, State]:
        stated = self.stated.delay_seconds if self.stated is not None else None
        alike = np.flatnonzero(left <= left[lag] * WORST_FACTOR + 1e-9)
        if self.offset is None:
            return _open("delay", "the log does not show from which row the state of an observation comes")
        if len(alike) > 1:
            return _open("delay", f"lags of {alike[0]} to {alike[-1]} rows explain the torques equally well")
        if self.log.time is None:
            return _open("delay", "the log has no stamps")
        row = float(np.median(np.diff(self.log.time)))
        rows = lag + self.offset - 1
        if rows < 0:
            return _open(
                "delay",
                "a row's torques follow the target that was made of this row's state: computed then, not measured with "
                "the state. Log the torque that acts when the state is read",
            )
        least, most = rows * row, (rows + 1) * row
        shown = f"{1e3 * least:.3g} to below {1e3 * most:.3g} ms by the log's torques"
        if stated is None:
            return _open("delay", f"nobody states it; it is {shown}")
        slack = 1e-3 * row
        if stated[1] < least - slack or stated[0] >= most - slack:
            said = f"{1e3 * stated[0]:.3g}" + (f" to {1e3 * stated[1]:.3g}" if stated[1] > stated[0] else "")
            raise self._refuted(f"the delay is {shown}, delay_seconds says {said} ms")
        return _shown("delay", shown)

    def _refuted(self, what: str) -> PolicyError:
        return PolicyError(
            f"{self.path}: the log {self.log.path} refutes its contract: {what}. Correct the contract (--layout), or "
            "the log's columns if they are wrong; or replay a log of this policy."
        )


def _changes(values: np.ndarray | None) -> np.ndarray:
    """Rows, from the third on, in which the policy was asked: their action is not that of the row before."""
    if values is None or len(values) < 3:
        return np.zeros(0, int)
    rows = np.flatnonzero(np.any(np.diff(values, axis=0) != 0, axis=1)) + 1
    return rows[rows >= 2]


def _open(items: str | tuple[str, ...], why: str) -> dict[str, State]:
    return dict.fromkeys((items,) if isinstance(items, str) else items, State(NOT_PROVEN, why))


def _shown(items: str | tuple[str, ...], why: str) -> dict[str, State]:
    return dict.fromkeys((items,) if isinstance(items, str) else items, State(PROVEN, why))
