"""The instrument `battery_gauge`: what the battery management of a simulated robot shows, from its drives' physics.

Per step and joint: copper, iron and inverter losses on top of tau * q'; all joints share a bus, whose sum the
battery delivers; windings and housings warm up and stay warm when policies are swapped; the gauge averages, delays,
rounds and holds. docs/twin.md gives every formula with its number.

Steps are collected and worked through in one go when a reading is asked for, because numpy on (K, W, J) arrays
costs hardly more than on (W, J).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hts.channels import Channel
from hts.contracts import Fact, Instrument, PhysicsSample, Reading, Robot, RobotSpec, Settings
from hts.errors import WorldError
from hts_power import drive_train
from hts_power.anchors import READINGS, facts
from hts_power.battery import Battery
from hts_power.gauge_parameters import GaugeParameters
from hts_power.structure import GaugeStructure

ENERGIES = ("idle", "mechanical", "copper", "iron", "inverter", "converter", "burned", "bus", "battery")
RATED_CELL_VOLTAGE = 3.7  # V; 22.2 V of six, at which the no-load speed is 30.09 rad/s (manual 1.4; motor constants)
CHUNK = 64  # steps worked through together at most


def make_gauge(settings: Settings, robot: Robot) -> BatteryGauge:
    """The factory of instrument `battery_gauge`. Raises WorldError for a robot whose motors are unknown."""
    return BatteryGauge(GaugeParameters.model_validate(dict(settings)), robot.spec)


class BatteryGauge(Instrument):
    """Battery current, voltage, charge and motor temperatures of W robots.

    battery_current is positive when discharging; the register of a real gauge is negative then, and log readers
    turn it round.
    """

    def __init__(self, parameters: GaugeParameters, spec: RobotSpec) -> None:
        if spec.motors is None:
            raise WorldError(
                f"Robot '{spec.name}' gives no motor constants (RobotSpec.motors), which the instrument "
                "'battery_gauge' needs to turn torque into current. Add them, or use another instrument."
            )
        self.p, self.spec = parameters, spec
        self.channels = (
            Channel("battery_current", "A", (), "drawn from the pack, positive when discharging"),
            Channel("battery_voltage", "V", (), "of the pack, sum of its cells"),
            Channel("state_of_charge", "%", (), "of the pack", may_be_constant=True),
            Channel("motor_temperature", "degC", (spec.num_joints,), "of each motor's housing", may_be_constant=True),
        )
        self._constant = np.array(spec.motors.torque_constant)
        self._ratio = np.array(spec.motors.gear_ratio)
        self._coefficient = drive_train.copper_coefficient(parameters.phase_resistance, self._constant)
        structure = parameters.structure
        if structure.resistance_spread > 0:
            fixed = np.random.default_rng([structure.machine, 5])
            self._coefficient *= 1 + structure.resistance_spread * fixed.uniform(-1, 1, spec.num_joints)
        self.reset(1, np.random.default_rng(0))

    def reset(self, num_worlds: int, rng: np.random.Generator) -> None:
        p, joints = self.p, (num_worlds, self.spec.num_joints)
        self._rng = rng
        s = p.structure
        self._charge_at_start: np.ndarray | float = p.state_of_charge
        if s.least_charge > 0:
            self._charge_at_start = rng.uniform(min(s.least_charge, p.state_of_charge), p.state_of_charge, num_worlds)
        self._ambient: np.ndarray | float = p.ambient
        if s.ambient_spread > 0:
            self._ambient = p.ambient + s.ambient_spread * rng.uniform(-1, 1, (num_worlds, 1))
        self._wander = rng.standard_normal(num_worlds) if s.idle_spread > 0 else None
        self._battery = self._new_battery(num_worlds, self._charge_at_start)
        self.winding = np.full(joints, p.start_temperature)
        self.housing = np.full(joints, p.start_temperature)
        self._count, self._dt = 0, 0.0
        self._torque, self._speed = np.empty((CHUNK, *joints)), np.empty((CHUNK, *joints))
        self._current_torque = np.empty((CHUNK, *joints))
        self._irregular = False  # whether a motor's current is not its torque over the nominal constant
        self._history = np.empty((0, num_worlds))
        self._steps = 0
        self._shown = self._register(self._battery.current)
        self._shown_voltage = self._cells(self._battery.voltage)
        self.energy = {name: np.zeros(num_worlds) for name in ENERGIES}
        """J since reset, (W,): what only a simulator knows. For calibration, never recorded."""
        self.seconds = 0.0
        self._told = (0.0, np.zeros(num_worlds))
        self._paid = (0.0, np.zeros(num_worlds), np.zeros(num_worlds))  # s, J and W, as `truth` was last asked
        self._since_settle()

    def step(self, sample: PhysicsSample) -> None:
        self._torque[self._count] = sample.motor_torque
        self._speed[self._count] = sample.joint_velocity
        if sample.current_torque is not None:
            self._current_torque[self._count] = sample.current_torque
            self._irregular = True
        self._count += 1
        self._dt = sample.dt
        if self._count == CHUNK:
            self._work()

    def advance(self, samples: PhysicsSample) -> None:
        done, steps, self._dt = 0, len(samples.motor_torque), samples.dt
        while done < steps:
            count = min(steps - done, CHUNK - self._count)
            now, some = slice(self._count, self._count + count), slice(done, done + count)
            self._torque[now], self._speed[now] = samples.motor_torque[some], samples.joint_velocity[some]
            if samples.current_torque is not None:
                self._current_torque[now] = samples.current_torque[some]
                self._irregular = True
            self._count, done = self._count + count, done + count
            if self._count == CHUNK:
                self._work()

    def read(self) -> Mapping[str, np.ndarray]:
        self._work()
        return {
            "battery_current": self._shown,
            "battery_voltage": self._shown_voltage,
            "state_of_charge": np.rint(100 * self._battery.state_of_charge),
            "motor_temperature": np.rint(self.housing),
        }

    def idle(self) -> Mapping[str, float]:
        """As read off over a minute: noise averages out, gain and offset do not."""
        battery = self._new_battery(1, self.p.state_of_charge)
        reading = (1 + self.p.gain_error) * battery.current[0] - self.p.offset
        return {"battery_current": float(reading), "battery_voltage": float(battery.voltage[0])}

    def exact(self) -> Mapping[str, np.ndarray]:
        """Voltage now, and the current that carries the bus's mean power at it: their product is what the drives and
        the electronics took, without the gauge's window, which misses that the voltage sags where the current peaks."""
        self._work()
        before, joules = self._told
        self._told = (self.seconds, self.energy["bus"].copy())
        voltage = self._battery.voltage
        if self.seconds == before:  # nothing has passed: as it idles
            return {"battery_current": self._battery.current.copy(), "battery_voltage": voltage.copy()}
        power = (self.energy["bus"] - joules) / (self.seconds - before)
        return {"battery_current": power / voltage, "battery_voltage": voltage.copy()}

    def exact_idle(self) -> Mapping[str, float]:
        """Without gain error and offset."""
        battery = self._new_battery(1, self.p.state_of_charge)
        return {"battery_current": float(battery.current[0]), "battery_voltage": float(battery.voltage[0])}

    def settle(self) -> None:
        """Steady heat for the mean tau^2 and iron loss since reset or the last settle, and steady polarisation.

        Raises WorldError if the windings would warm up without end.
        """
        self._work()
        if self._settle_seconds == 0:
            return
        p = self.p
        winding, housing = drive_train.steady_temperatures(
            self._torque_squared / self._settle_seconds,
            self._iron / self._settle_seconds,
            self._coefficient,
            self._ambient,
            p.winding_resistance,
            p.housing_resistance,
        )
        if not np.isfinite(winding).all():
            joint = self.spec.joint_names[int(np.argwhere(~np.isfinite(winding))[0][1])]
            raise WorldError(
                f"The motor of {joint} would overheat: its windings find no steady temperature under the mean torque "
                "of the warm-up. Warm up with a policy that needs less torque, or at a lower speed."
            )
        self.winding, self.housing = winding, housing
        self._battery.settle(self._charge / self._settle_seconds)
        self._since_settle()

    def describe(self) -> Mapping[str, Any]:
        off = self.p.structure == GaugeStructure()  # then it is the gauge of before there were structures
        return self.p.model_dump(mode="json", exclude={"structure"} if off else None)

    def supply(self) -> np.ndarray | None:
        """Against the voltage that the motors' no-load speed is given for."""
        return self._battery.voltage / (RATED_CELL_VOLTAGE * self.p.cells)

    def truth(self) -> Mapping[str, np.ndarray]:
        """Of the current: mean power on the bus that is not idle, W. It is what the score makes of current and voltage,
        before the pack's own loss."""
        self._work()
        seconds, joules, net = self._paid
        if self.seconds > seconds:
            spent = self.energy["bus"] - self.energy["idle"]
            net = (spent - joules) / (self.seconds - seconds)
            self._paid = (self.seconds, spent, net)
        return {"battery_current": net}

    def conditions(self) -> Mapping[str, np.ndarray]:
        """Charge in whole per cent and air in whole degrees, where they differ from session to session."""
        s, noted = self.p.structure, {}
        if s.least_charge > 0:
            noted["state_of_charge"] = np.round(100 * np.asarray(self._charge_at_start))
        if s.ambient_spread > 0:
            noted["ambient"] = np.round(np.asarray(self._ambient)[:, 0])
        return noted

    def facts(self) -> Sequence[Fact]:
        """Published figures of this robot, if there are any (anchors.py)."""
        return facts(self.spec.name)

    def readings(self) -> Sequence[Reading]:
        """Idle, gross and net power."""
        return READINGS

    # ------------------------------------------------------------------------------------------ inside

    def _new_battery(self, num: int, state_of_charge: np.ndarray | float) -> Battery:
        p = self.p
        return Battery(
            num,
            state_of_charge,
            p.cells,
            3600 * p.capacity,
            p.pack_resistance,
            p.polarisation_resistance,
            p.polarisation_seconds,
            p.bus_capacitance,
            p.idle_power,
        )

    def _since_settle(self) -> None:
        self._torque_squared = np.zeros_like(self.winding)
        self._iron = np.zeros_like(self.winding)
        self._charge = np.zeros(len(self.winding))
        self._settle_seconds = 0.0

    def _work(self) -> None:
        """Work through the steps collected so far."""
        count, self._count = self._count, 0
        if count == 0:
            return
        p, dt = self.p, self._dt
        torque, speed = self._torque[:count], self._speed[:count]  # (K, W, J)
        mechanical = torque * speed
        if self._irregular:
            torque = self._current_torque[:count]  # from here on it stands for the current
        copper = drive_train.copper_power(torque, self._coefficient, self.winding)
        iron = drive_train.iron_power(self._ratio * speed, p.hysteresis, p.eddy)
        inverter = drive_train.inverter_power(
            np.abs(torque) / self._constant,
            self._battery.voltage[:, None],
            p.switch_resistance,
            p.switching_seconds,
            p.dead_seconds,
            p.switching_frequency,
            p.diode_voltage,
        )
        seconds = count * dt
        joints = mechanical + copper + iron + inverter
        idle, converted, burned = self._idle_power(seconds), 0.0, 0.0
        if p.structure.converter_share > 0:
            loss = drive_train.converter_power(joints, p.structure.converter_share, p.structure.converter_square)
            joints = joints + loss
            converted = np.einsum("kwj->w", loss) * dt
        if p.structure.own_regeneration:
            burned = -np.einsum("kwj->w", np.minimum(joints, 0)) * dt
            joints = np.maximum(joints, 0)
        bus = drive_train.bus_power(idle, joints, p.regeneration)
        current = self._battery.deliver(bus, dt)

        copper, iron = np.add.reduce(copper) * dt, np.add.reduce(iron) * dt  # J of each motor from here on
        self._warm(copper / seconds, iron / seconds, seconds)
        self._torque_squared += np.einsum("kwj,kwj->wj", torque, torque) * dt
        self._iron += iron
        charge = np.add.reduce(current) * dt
        self._charge += charge
        self._settle_seconds += seconds
        for name, joules in (
            ("idle", idle * seconds),
            ("mechanical", np.einsum("kwj->w", mechanical) * dt),
            ("copper", np.add.reduce(copper, axis=1)),
            ("iron", np.add.reduce(iron, axis=1)),
            ("inverter", np.einsum("kwj->w", inverter) * dt),
            ("converter", converted),
            ("burned", burned),
            ("bus", np.add.reduce(bus) * dt),
            ("battery", charge * self._battery.voltage),
        ):
            self.energy[name] += joules
        self.seconds += seconds
        self._sense(current, dt)

    def _idle_power(self, seconds: float) -> np.ndarray | float:
        """P_idle of the next `seconds`, W; if it wanders P_idle (1 + sigma x), x Ornstein-Uhlenbeck (W,)."""
        s = self.p.structure
        if self._wander is None:
            return self.p.idle_power
        keep = np.exp(-seconds / max(s.idle_seconds, 1e-3))
        self._wander = keep * self._wander + np.sqrt(1 - keep**2) * self._rng.standard_normal(len(self._wander))
        return self.p.idle_power * np.maximum(1 + s.idle_spread * self._wander, 0)

    def _warm(self, copper: np.ndarray, iron: np.ndarray, seconds: float) -> None:
        """(10) C_w T_w' = P_cu + P_fe/2 - (T_w - T_h)/R_wh; C_h T_h' = (T_w - T_h)/R_wh - (T_h - T_a)/R_ha."""
        p = self.p
        inner = (self.winding - self.housing) / p.winding_resistance
        outer = (self.housing - self._ambient) / p.housing_resistance
        self.winding = self.winding + seconds / p.winding_capacity * (copper + 0.5 * iron - inner)
        self.housing = self.housing + seconds / p.housing_capacity * (inner - outer)

    def _sense(self, current: np.ndarray, dt: float) -> None:
        """(11) The register: mean over the window, as it was `delay` ago, at each update since the last look.

        A low-pass, y' = (I - y) / W, is taken before; its history then needs no window.
        """
        p = self.p
        window, late = max(1, round(p.window / dt)), round(p.delay / dt)
        if p.structure.low_pass:
            window = 1
        if len(self._history) < window + late:  # before the first step it had been idling
            self._history = np.tile(
                self._new_battery(current.shape[1], self._charge_at_start).current, (window + late, 1)
            )
        if p.structure.low_pass:
            from scipy.signal import lfilter  # a second of each process of a twin, of which few have this gauge

            keep = np.exp(-dt / p.window)  # exact for a current that is constant over a step
            current, _ = lfilter([1 - keep], [1, -keep], current, axis=0, zi=keep * self._history[-1:])
        self._history = np.concatenate([self._history[-(window + late) :], current])
        every = max(1, round(1 / (p.update_rate * dt)))
        first = -(self._steps + 1) % every  # steps until the register changes; counted back by `late` from the newest
        for step in range(first, len(current), every):
            self._shown = self._register(np.add.reduce(self._history[step + 1 : step + 1 + window]) / window)
            self._shown_voltage = self._cells(self._battery.voltage)
        self._steps += len(current)

    def _register(self, current: np.ndarray) -> np.ndarray:
        """A reading of a true current (W,), A, turned positive for discharge."""
        p = self.p
        reading = -(1 + p.gain_error) * current + p.offset + p.noise * self._rng.standard_normal(current.shape)
        return -(np.rint(reading / p.resolution) * p.resolution if p.resolution > 0 else reading)

    def _cells(self, voltage: np.ndarray) -> np.ndarray:
        """Sum of the cell voltages as read, each in whole millivolts, (W,)."""
        cells = voltage[:, None] / self.p.cells + self.p.cell_noise * self._rng.standard_normal(
            (len(voltage), self.p.cells)
        )
        return np.rint(1000 * cells).sum(axis=1) / 1000
