"""MAVLink: UAVs as vehicles of that protocol, and setpoints of clients that steer them.

The only file that imports pymavlink, which the extra `mavlink` installs. UAV k is the system k + 1. The scenario's x
points east and its y north, as on a map, so the local frame of MAVLink (north, east, down) swaps them.
"""

import math
import struct
from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.state import BEYOND_SENSE, States, in_three, position, velocity
from meanflock.swarm.wire.messages import Status

SYSTEMS = 255  # largest system id
HEARTBEAT_S = 1.0  # time between two heartbeats of a vehicle
LOCAL_NED: int = mavlink.MAV_FRAME_LOCAL_NED
_EARTH_M = 6_371_000.0  # radius, as autopilots project
_AUTOPILOT = mavlink.MAV_COMP_ID_AUTOPILOT1
_UNKNOWN_HEADING = 2**16 - 1
_V1, _V2, _SIGNED = 0xFE, 0xFD, 0x01
_FRAMING = {_V1: 8, _V2: 12}  # bytes of a frame without its payload
_SIGNATURE = 13
_ANY_VERTICAL = mavlink.POSITION_TARGET_TYPEMASK_AZ_IGNORE
ACCELERATION: int = (  # mask of a setpoint of accelerations: all else is ignored
    mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Y_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VY_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VZ_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
)
_SYSTEM_STATUS = {
    Status.FLYING: mavlink.MAV_STATE_ACTIVE,
    Status.ARRIVED: mavlink.MAV_STATE_STANDBY,
    Status.LOST: mavlink.MAV_STATE_EMERGENCY,
    Status.LANDED: mavlink.MAV_STATE_STANDBY,
}


Base: TypeAlias = tuple[float, float, float]  # place of a station: x, y and height, m


class Home(NamedTuple):
    """Place on the Earth of the scenario's origin: degrees, and metres above sea level."""

    latitude: float
    longitude: float
    altitude: float = 0.0

    @classmethod
    def parse(cls, text: str) -> "Home":
        """The home in a text LATITUDE,LONGITUDE[,ALTITUDE].

        Raises:
            BadInput: the text is written otherwise, or there is no such place.
        """
        try:
            home = cls(*map(float, text.split(",")))
        except (TypeError, ValueError):
            home = cls(math.nan, math.nan)
        if not (abs(home.latitude) <= 89.0 and abs(home.longitude) <= 180.0 and abs(home.altitude) <= 1e5):
            raise BadInput(
                f"--home {text}: latitude and longitude in degrees, at most 89 and 180, and perhaps metres above sea "
                "level; for example --home 47.397742,8.545594,488"
            )
        return home

    def position(self, east: float, north: float) -> tuple[int, int]:
        """Latitude and longitude of a point of the plane, in 1e-7 degrees."""
        latitude = self.latitude + math.degrees(north / _EARTH_M)
        longitude = self.longitude + math.degrees(east / (_EARTH_M * math.cos(math.radians(self.latitude))))
        return round(max(-90.0, min(90.0, latitude)) * 1e7), round(math.remainder(longitude, 360.0) * 1e7)


class MavlinkVehicle:
    """A UAV as a MAVLink vehicle; makes its messages, each a frame with the next sequence number."""

    def __init__(self, uav: int, dt: float) -> None:
        """`dt`: seconds a tick."""
        self._sender = mavlink.MAVLink(None, srcSystem=uav + 1, srcComponent=_AUTOPILOT)
        self._tick_ms = dt * 1e3

    def heartbeat(self, status: int) -> bytes:
        """HEARTBEAT of a multicopter, armed while it is on its way."""
        armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if status == Status.FLYING else 0
        return self._frame(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_QUADROTOR,
                mavlink.MAV_AUTOPILOT_GENERIC,
                mavlink.MAV_MODE_FLAG_GUIDED_ENABLED | armed,
                0,
                _SYSTEM_STATUS[Status(status)],
                3,  # version of the protocol
            )
        )

    def local_position(self, tick: int, x: float, y: float, z: float, vx: float, vy: float, vz: float) -> bytes:
        """LOCAL_POSITION_NED of a place and a velocity, z upward."""
        return self._frame(mavlink.MAVLink_local_position_ned_message(self._time_ms(tick), y, x, -z, vy, vx, -vz))

    def global_position(
        self, home: Home, tick: int, x: float, y: float, z: float, vx: float, vy: float, vz: float
    ) -> bytes:
        """GLOBAL_POSITION_INT of a place and a velocity about a home, z upward."""
        latitude, longitude = home.position(x, y)
        heading = round(100.0 * math.degrees(math.atan2(vx, vy))) % 36_000 if vx or vy else _UNKNOWN_HEADING
        altitude, above_home = _millimetres(home.altitude + z), _millimetres(z)
        speed = _centimetres(vy), _centimetres(vx), _centimetres(-vz)
        return self._frame(
            mavlink.MAVLink_global_position_int_message(
                self._time_ms(tick), latitude, longitude, altitude, above_home, *speed, heading
            )
        )

    def home_position(self, home: Home, x: float, y: float, z: float) -> bytes:
        """HOME_POSITION at a point, `z` above the plane of the origin; the approach to it is left out."""
        latitude, longitude = home.position(x, y)
        altitude = round(1e3 * (home.altitude + z))
        upright = (1.0, 0.0, 0.0, 0.0)
        return self._frame(
            mavlink.MAVLink_home_position_message(latitude, longitude, altitude, y, x, -z, upright, 0.0, 0.0, 0.0)
        )

    def _time_ms(self, tick: int) -> int:
        return round(tick * self._tick_ms) % 2**32

    def _frame(self, message: mavlink.MAVLink_message) -> bytes:
        frame: bytes = message.pack(self._sender)
        self._sender.seq = (self._sender.seq + 1) % 256
        return frame


class MavlinkFleet:
    """The UAVs of a flight that have a system id, as vehicles: a datagram of each in a tick."""

    def __init__(self, uavs: int, dt: float, home: Home | None = None, base: Base | None = None) -> None:
        """`dt`: seconds a tick. `home`: of GLOBAL_POSITION_INT; None: that message is left out. `base`: place of a
        station, m, which is the HOME_POSITION; None: there is none.
        """
        self._vehicles = [MavlinkVehicle(uav, dt) for uav in range(min(uavs, SYSTEMS))]
        self._home, self._base = home, base
        self._beat_s = -math.inf

    def __len__(self) -> int:
        return len(self._vehicles)

    def beat(self) -> None:
        """Let the next datagrams have heartbeats, whenever the last ones were sent."""
        self._beat_s = -math.inf

    def datagrams(self, tick: int, states: States, status: np.ndarray, now_s: float) -> Iterator[bytes]:
        """The messages of each vehicle in a tick: a heartbeat if it is due, and positions.

        Args:
            states: (N, 2d); in the plane z is 0. status: (N,). now_s: seconds of a monotonic clock.
        """
        is_due = now_s - self._beat_s >= HEARTBEAT_S
        if is_due:
            self._beat_s = now_s
        rows = np.concatenate([in_three(position(states)), in_three(velocity(states))], axis=-1)
        for vehicle, row, now in zip(self._vehicles, rows.tolist(), status.tolist(), strict=False):
            datagram = vehicle.heartbeat(now) if is_due else b""
            datagram += vehicle.local_position(tick, *row)
            if self._home is not None:
                datagram += vehicle.global_position(self._home, tick, *row)
                if is_due and self._base is not None:
                    datagram += vehicle.home_position(self._home, *self._base)
            yield datagram


class WireSetpoint(NamedTuple):
    """Acceleration of a UAV that a client asks for, m/s² along x, y and z of the scenario; z is 0 if it is ignored."""

    uav: int
    acceleration: tuple[float, float, float]


class Reader:
    """Reader of the datagrams of clients."""

    def __init__(self, uavs: int) -> None:
        self._uavs = min(uavs, SYSTEMS)
        self._decoder = mavlink.MAVLink(None)

    def read(self, datagram: bytes) -> Iterator[WireSetpoint | MessageRejected | None]:
        """The content of each frame of a datagram: a setpoint, an error, or None for another message of MAVLink.

        Reasons of errors: `malformed`, `unknown-system`, `wrong-frame`, `wrong-mask`, `non-finite`.
        """
        rest = datagram
        while rest:
            size = _size(rest)
            if not 0 < size <= len(rest):
                yield MessageRejected("malformed", f"{len(rest)} bytes are no frame of MAVLink")
                return
            try:
                yield self._setpoint(self._decoder.decode(bytearray(rest[:size])))
            except (mavlink.MAVError, struct.error) as error:
                yield MessageRejected("malformed", str(error))
            except MessageRejected as error:
                yield error
            rest = rest[size:]

    def _setpoint(self, message: mavlink.MAVLink_message) -> WireSetpoint | None:
        if message.get_msgId() != mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
            return None
        system = message.target_system
        frame = message.coordinate_frame
        mask = message.type_mask
        north, east = message.afx, message.afy
        down = 0.0 if mask & _ANY_VERTICAL else message.afz
        if not 0 < system <= self._uavs:
            raise MessageRejected("unknown-system", f"system {system}; the UAVs are 1 to {self._uavs}")
        if frame != LOCAL_NED:
            raise MessageRejected("wrong-frame", f"frame {frame}; only {LOCAL_NED}, LOCAL_NED, is flown")
        if mask | _ANY_VERTICAL != ACCELERATION | _ANY_VERTICAL:
            raise MessageRejected("wrong-mask", f"type mask {mask:#06x}; only accelerations, {ACCELERATION:#06x}")
        if not all(abs(along) < BEYOND_SENSE for along in (north, east, down)):
            raise MessageRejected("non-finite", f"acceleration ({north}, {east}, {down})")
        return WireSetpoint(system - 1, (east, north, -down))


def _size(frame: bytes) -> int:
    """Length of the frame at the beginning of some bytes; 0 if there is none."""
    if frame[0] not in _FRAMING or len(frame) < 3:
        return 0
    signature = _SIGNATURE if frame[0] == _V2 and frame[2] & _SIGNED else 0
    return _FRAMING[frame[0]] + frame[1] + signature


def _millimetres(metres: float) -> int:
    return max(-(2**31), min(2**31 - 1, round(1e3 * metres)))


def _centimetres(metres: float) -> int:
    return max(-(2**15), min(2**15 - 1, round(1e2 * metres)))
