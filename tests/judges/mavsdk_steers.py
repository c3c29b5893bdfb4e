"""Runs in an environment with MAVSDK: finds the vehicles of a flight, listens to them and steers one.

Prints as JSON what came: the systems, and for each the messages LOCAL_POSITION_NED and the states of the plug-in
`telemetry`.

Arguments: the URL of the connection, the number of vehicles, and the system to steer to the north; 0 for none.
"""

import json
import sys
import time

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.mavlink_direct import MavlinkDirect
from mavsdk.plugins.offboard.offboard import AccelerationNed, Offboard
from mavsdk.plugins.telemetry import Telemetry

DEADLINE_S = 60.0
MESSAGES = 20  # of each vehicle, to begin with and while one is steered
STRONG = 4.0  # m/s²

url, vehicles, steered = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
client = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
client.add_any_connection(url)


def until(holds):
    """Wait until a condition holds, or the deadline is over; the judge sees what came."""
    end = time.monotonic() + DEADLINE_S
    while not holds() and time.monotonic() < end:
        time.sleep(0.05)


def has_come(count):
    """True if every vehicle has sent so many messages, and both plug-ins have them."""
    return all(len(came) >= count for by_vehicle in (messages, states) for came in by_vehicle.values())


def autopilots():
    """Systems whose heartbeat has come; a system that is only counted may lack it."""
    return {system.get_system_id(): system for system in client.get_systems() if system.has_autopilot()}


until(lambda: len(autopilots()) >= vehicles)
systems = autopilots()
messages = {number: [] for number in systems}
states = {number: [] for number in systems}
plugins = []
for number, system in systems.items():
    direct, telemetry = MavlinkDirect(system), Telemetry(system)
    direct.subscribe_message(
        "LOCAL_POSITION_NED", lambda message, into: into.append(json.loads(message.fields_json)), messages[number]
    )
    telemetry.subscribe_position_velocity_ned(
        lambda state, into: into.append(
            [state.position.north_m, state.position.east_m, state.velocity.north_m_s, state.velocity.east_m_s]
        ),
        states[number],
    )
    plugins += [direct, telemetry]
until(lambda: has_come(MESSAGES))
if steered:
    plugins.append(Offboard(systems[steered]))
    plugins[-1].set_acceleration_ned(AccelerationNed(STRONG, 0.0, 0.0))  # it repeats this by itself
    steered_from = max(map(len, messages.values()))
    until(lambda: has_come(steered_from + MESSAGES))
for plugin in plugins:
    plugin.destroy()
client.destroy()
print(json.dumps({"systems": sorted(systems), "messages": messages, "states": states}))
