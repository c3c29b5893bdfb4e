"""A tick of quadrotors: rigid bodies under a geometric attitude controller (Lee, Leok and McClamroch, CDC 2010), whose
four rotors follow their wanted speeds with a lag.

A row of `body` is [attitude: quaternion w, x, y, z; body rates, rad/s: 3; rotor speeds, rad/s: 4; mean power, W].
"""

import math
from typing import NamedTuple

import numpy as np

from meanflock.kernels.state import Floats

GRAVITY = 9.81  # m/s²
ATTITUDE, RATES, ROTORS, POWER = slice(0, 4), slice(4, 7), slice(7, 11), 11
BODY = 12  # columns of `body`
_UNIT = 1e-6  # deviation of the squared length of an attitude from 1


class Craft(NamedTuple):
    """Constants of a quadrotor and of its inner loop. The rotors are at ±arm/√2 along both axes of the body.

    mass: kg. inertia_x, inertia_y, inertia_z: kg m². arm: from the centre to a rotor, m. k_eta: thrust over squared
    rotor speed, N s²/rad². k_m: torque over squared rotor speed, N m s²/rad². lag: share of the way to the wanted speed
    that a rotor covers in a step. speed_max: of a rotor, rad/s. k_p, k_d: gains of attitude and rates, 1/s² and 1/s.
    drag: 1/s. step: s.
    """

    mass: float
    inertia_x: float
    inertia_y: float
    inertia_z: float
    arm: float
    k_eta: float
    k_m: float
    lag: float
    speed_max: float
    k_p: float
    k_d: float
    drag: float
    step: float


def fly(
    craft: Floats,
    states: Floats,
    body: Floats,
    wanted: Floats,
    outside: Floats,
    steps: int,
    moved: Floats,
    turned: Floats,
    /,
) -> None:
    """Write the states (N, 6) and bodies (N, 12) after so many steps to `moved` and `turned`.

    The wanted thrust is m (wanted + g e_z), without a part that points down. The body turns its z axis there, and its
    x axis as near to that of the world as it then can: heading 0. The controller acts at the start of a step;
    velocities, places and attitudes follow by the trapezoidal rule.

    Args:
        craft: (13,), the fields of `Craft`. wanted: (N, 3), m/s². outside: (N, 3), m/s², acceleration by all
            but thrust, gravity and drag through still air. steps: at least 1.

    Raises:
        ValueError: the attitude of a row is no unit quaternion.
    """
    m, jx, jy, jz, arm, k, k_m, lag, speed_max, k_p, k_d, drag, h = craft.tolist()
    reach, ratio, most = arm * math.sqrt(0.5), k_m / k, k * (speed_max * speed_max)
    half, quarter = 0.5 * h, 0.25 * h
    tilt_share, yaw_share = 0.25 / reach, 0.25 / ratio
    of_k, of_m, of_jx, of_jy, of_jz = 1 / k, 1 / m, 1 / jx, 1 / jy, 1 / jz
    length = (body[:, ATTITUDE] ** 2).sum(axis=1)
    if not (unit := np.abs(length - 1.0) <= _UNIT).all():
        raise ValueError(f"body: the attitude of row {np.flatnonzero(~unit)[0]} is no unit quaternion")
    x, y, z, vx, vy, vz = states.T
    qw, qx, qy, qz, wx, wy, wz, *rotors, _ = body.T
    ox, oy, oz = outside.T
    # The wanted thrust, its direction c, and the wanted axes b2 = (0, dy, dz) and b1 = (ex, ey, ez).
    up = wanted[:, 2] + GRAVITY
    fx, fy, fz = m * wanted[:, 0], m * wanted[:, 1], m * np.where(up > 0.0, up, 0.0)
    length = np.sqrt(fx * fx + fy * fy + fz * fz)
    pulls = length > 1e-9 * m
    safe = np.where(pulls, length, 1.0)
    cx, cy, cz = np.where(pulls, fx / safe, 0.0), np.where(pulls, fy / safe, 0.0), np.where(pulls, fz / safe, 1.0)
    across = np.sqrt(cz * cz + cy * cy)
    turns = across > 1e-6
    safe = np.where(turns, across, 1.0)
    dy, dz = np.where(turns, cz / safe, 1.0), np.where(turns, -cy / safe, 0.0)
    ex, ey, ez = dy * cz - dz * cy, dz * cx, -dy * cx
    spent = np.zeros(len(states))
    for _ in range(steps):
        r11, r12, r13 = 1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy - qw * qz), 2.0 * (qx * qz + qw * qy)
        r21, r22, r23 = 2.0 * (qx * qy + qw * qz), 1.0 - 2.0 * (qx * qx + qz * qz), 2.0 * (qy * qz - qw * qx)
        r31, r32, r33 = 2.0 * (qx * qz - qw * qy), 2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)
        thrust = _within(fx * r13 + fy * r23 + fz * r33, 4.0 * most)
        # Error of the attitude, and ω × Jω.
        e1 = 0.5 * ((cx * r12 + cy * r22 + cz * r32) - (r23 * dy + r33 * dz))
        e2 = 0.5 * ((ex * r13 + ey * r23 + ez * r33) - (r11 * cx + r21 * cy + r31 * cz))
        e3 = 0.5 * ((dy * r21 + dz * r31) - (r12 * ex + r22 * ey + r32 * ez))
        gx, gy, gz = (jz - jy) * wy * wz, (jx - jz) * wz * wx, (jy - jx) * wx * wy
        u1 = tilt_share * (gx - jx * (k_p * e1 + k_d * wx))
        u2 = tilt_share * (gy - jy * (k_p * e2 + k_d * wy))
        u3 = yaw_share * (gz - jz * (k_p * e3 + k_d * wz))
        u0 = 0.25 * thrust
        # Rotors at (+, +), (+, −), (−, −), (−, +); they turn +, −, +, −.
        forces = (u0 + u1 - u2 + u3, u0 - u1 - u2 - u3, u0 - u1 + u2 + u3, u0 + u1 + u2 - u3)
        before = [speed * speed for speed in rotors]
        rotors = [
            speed + lag * (np.sqrt(_within(force, most) * of_k) - speed)
            for speed, force in zip(rotors, forces, strict=True)
        ]
        after = [speed * speed for speed in rotors]
        s1, s2, s3, s4 = (0.5 * (first + last) for first, last in zip(before, after, strict=True))
        t1 = (k * reach) * ((s1 - s2) - s3 + s4)
        t2 = (k * reach) * ((s3 - s1) - s2 + s4)
        t3 = k_m * ((s1 - s2) + s3 - s4)
        pull = (k * of_m) * (((s1 + s2) + s3) + s4)
        next_vx = vx + h * (pull * r13 + ox - drag * vx)
        next_vy = vy + h * (pull * r23 + oy - drag * vy)
        next_vz = vz + h * (pull * r33 + oz - GRAVITY - drag * vz)
        x, y, z = x + half * (vx + next_vx), y + half * (vy + next_vy), z + half * (vz + next_vz)
        vx, vy, vz = next_vx, next_vy, next_vz
        next_wx, next_wy, next_wz = (
            wx + h * ((t1 - gx) * of_jx),
            wy + h * ((t2 - gy) * of_jy),
            wz + h * ((t3 - gz) * of_jz),
        )
        hx, hy, hz = quarter * (wx + next_wx), quarter * (wy + next_wy), quarter * (wz + next_wz)
        wx, wy, wz = next_wx, next_wy, next_wz
        nw = qw - hx * qx - hy * qy - hz * qz
        nx = qx + hx * qw + hz * qy - hy * qz
        ny = qy + hy * qw - hz * qx + hx * qz
        nz = qz + hz * qw + hy * qx - hx * qy
        shrink = 1.0 / np.sqrt(nw * nw + nx * nx + ny * ny + nz * nz)
        qw, qx, qy, qz = nw * shrink, nx * shrink, ny * shrink, nz * shrink
        cubes = [speed * squared for speed, squared in zip(rotors, after, strict=True)]
        spent = spent + (((cubes[0] + cubes[1]) + cubes[2]) + cubes[3])
    moved[...] = np.stack([x, y, z, vx, vy, vz], axis=-1)
    turned[...] = np.stack([qw, qx, qy, qz, wx, wy, wz, *rotors, (k_m / steps) * spent], axis=-1)


def _within(force: Floats, most: float) -> Floats:
    """Forces from 0 to `most`."""
    force = np.where(force > 0.0, force, 0.0)
    return np.where(force < most, force, most)
