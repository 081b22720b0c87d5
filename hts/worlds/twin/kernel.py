"""Physics steps of W robots, compiled: control law, drives and engine, element by element as `Dynamics` has them.

Nothing is reordered or fused, so the results are those of `Dynamics._step` to the last bit; a test holds one against
the other. Only the `exp` of static friction is left to numpy, whose own has its own last bits. Importing this module
compiles, or reads what was compiled before; only `compiled.load` imports it, after the engine's symbols are known.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit, types

from hts.worlds.twin.drives import CROSSING_TORQUE

void, integer, real, flag = types.void, types.int64, types.float64, types.boolean
address = types.intp
indices, vector, matrix, block = types.int64[::1], types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
counts = types.int64[:, ::1]

mj_step = types.ExternalFunction("mj_step", void(address, address))
mj_set_state = types.ExternalFunction("mj_setState", void(address, address, address, types.int32))
mj_get_state = types.ExternalFunction("mj_getState", void(address, address, address, types.int32))

SIGNATURE = void(
    *(integer, integer, integer, real),  # first, last, now, dt
    *(counts, block, matrix, matrix, vector),  # arrivals, sent, target, pull, offset
    *(matrix, matrix, vector, vector, block),  # kp, kd, limit, limit_start, limit_slope
    *(flag, vector, vector, real, real, matrix, matrix),  # driven, constant, saturation, half, rate, play, stiction
    *(vector, vector, matrix, matrix),  # loss, loss_slope, motor, current
    *(indices, address, types.int32, types.int32, vector, vector),  # models, data, full, control, warm_start, sensors
    *(matrix, matrix, matrix, matrix),  # state, inputs, acceleration, sensordata
    *(integer, indices, indices, indices, indices),  # velocities, qpos, qvel, touch, foot_velocity
    *(block, block, block, block, block),  # motors, currents, speeds, forces, approach
)


def _compiled(signature: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator: compiles for these types of arguments, and keeps the result where it can."""
    how = {"error_model": "numpy", "fastmath": False, "nogil": True}

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        try:
            return njit(signature, cache=True, **how)(function)
        except RuntimeError as error:  # neither this folder nor the user's cache can be written
            if "no locator" not in str(error):
                raise
            return njit(signature, **how)(function)

    return decorate


@_compiled(SIGNATURE)
def advance(
    first, last, now, dt,
    arrivals, sent, target, pull, offset,
    kp, kd, limit, limit_start, limit_slope,
    driven, constant, saturation, half, rate, play, stiction,
    loss, loss_slope, motor, current,
    models, data, full, control, warm_start, sensors,
    state, inputs, acceleration, sensordata,
    velocities, qpos, qvel, touch, foot_velocity,
    motors, currents, speeds, forces, approach,
):  # fmt: skip
    """Steps first to last - 1 of those that begin with link step `now`. Names and shapes as in `Dynamics`."""
    joints, nv = limit.shape[0], acceleration.shape[1]
    for w in range(state.shape[0]):
        own, before = state[w], acceleration[w]
        for step in range(first, last):
            for packet in range(arrivals.shape[0]):
                if arrivals[packet, w] == now + step:
                    for j in range(joints):
                        target[w, j] = sent[packet, w, j]
                        pull[w, j] = kp[w, j] * (target[w, j] - offset[j])
            for j in range(joints):
                speed = own[qvel[j]]
                torque = pull[w, j] - own[qpos[j]] * kp[w, j]
                if driven:
                    torque -= play[w, j] * kp[w, j]
                torque -= speed * kd[w, j]
                # `a if a < b or a != a else b` is numpy's minimum, NaN and signed zeros included.
                forwards = limit_start[j] - speed * limit_slope[0, w, j]
                forwards = forwards if forwards < limit[j] or forwards != forwards else limit[j]
                forwards = forwards if forwards > 0.0 or forwards != forwards else 0.0
                backwards = limit_start[j] - speed * limit_slope[1, w, j]
                backwards = backwards if backwards < limit[j] or backwards != backwards else limit[j]
                backwards = -(backwards if backwards > 0.0 or backwards != backwards else 0.0)
                torque = torque if torque < forwards or torque != torque else forwards
                torque = torque if torque > backwards or torque != torque else backwards
                current[w, j] = torque
                currents[step, w, j] = torque
                if driven:
                    torque = constant[j] * torque * (1.0 - saturation[j] * (torque * torque))
                    if half > 0.0:
                        side = torque / CROSSING_TORQUE
                        side = side if side > -1.0 or side != side else -1.0
                        side = side if side < 1.0 or side != side else 1.0
                        play[w, j] += rate * (half * side - play[w, j])
                motor[w, j] = torque
                motors[step, w, j] = torque
                speeds[step, w, j] = speed
                most = abs(torque) * loss[j]
                if driven:
                    most += stiction[w, j]
                friction = speed * loss_slope[j]
                friction = friction if friction < most or friction != friction else most
                friction = friction if friction > -most or friction != friction else -most
                inputs[w, j] = torque - friction

            mj_set_state(models[w], data, own.ctypes.data, full)
            for i in range(nv):
                warm_start[i] = before[i]
                before[i] = own[velocities + i]
            mj_set_state(models[w], data, inputs[w].ctypes.data, control)
            mj_step(models[w], data)
            mj_get_state(models[w], data, own.ctypes.data, full)
            for i in range(nv):
                before[i] = (own[velocities + i] - before[i]) / dt
            for i in range(sensors.shape[0]):
                sensordata[w, i] = sensors[i]
            for foot in range(touch.shape[0]):
                forces[step, w, foot] = sensors[touch[foot]]
                approach[step, w, foot] = -sensors[foot_velocity[foot]]


@_compiled(void(matrix, integer, matrix))
def rotate(state, quaternion, rows):
    """The nine rows of `Dynamics.rotation`, (9, W), of states (W, size) whose quaternion begins at this column."""
    for i in range(state.shape[0]):
        w, x, y, z = state[i, quaternion], state[i, quaternion + 1], state[i, quaternion + 2], state[i, quaternion + 3]
        rows[0, i] = 1 - 2 * (y * y + z * z)
        rows[1, i] = 2 * (x * y + w * z)
        rows[2, i] = 2 * (x * z - w * y)
        rows[3, i] = 2 * (x * y - w * z)
        rows[4, i] = 1 - 2 * (x * x + z * z)
        rows[5, i] = 2 * (y * z + w * x)
        rows[6, i] = 2 * (x * z + w * y)
        rows[7, i] = 2 * (y * z - w * x)
        rows[8, i] = 1 - 2 * (x * x + y * y)
