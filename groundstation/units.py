"""The unit of a scenario's key, as a table, an axis and a CSV file write it."""

UNITS = {
    "uavs": "UAVs",
    "dt": "s",
    "duration": "s",
    "start.centre": "m",
    "start.spacing": "m",
    "start.height": "m",
    "destination.radius": "m, m/s",
    "wind.sigma": "m/s/√s",
    "wind.mean": "m/s",
    "wind.drag": "1/s",
    "cost.c1": "s²/m²",
    "cost.c3": "s⁴/m²",
    "cost.epsilon": "m²",
    "learner.kappa": "1/s",
    "learner.position_scale": "m",
    "learner.velocity_scale": "m/s",
    "density.position_bandwidth": "m",
    "density.velocity_bandwidth": "m/s",
    "density.node_position_std": "m",
    "density.node_velocity_std": "m/s",
    "offline.speed_max": "m/s",
    "offline.acceleration_max": "m/s²",
    "federation.period": "ticks",
    "federation.state_period": "ticks",
    "radio.tx_power_dbm": "dBm",
    "radio.bandwidth_hz": "Hz",
    "radio.noise_psd_dbm_hz": "dBm/Hz",
    "radio.target_snr_db": "dB",
    "radio.coherence_time_s": "s",
    "radio.latency_threshold_slots": "slots",
    "radio.bits_per_float": "bit",
    "radio.range_m": "m",
    "vehicle.blade_power": "W",
    "vehicle.induced_power": "W",
    "vehicle.parasite_drag": "W s³/m³",
    "vehicle.tip_speed": "m/s",
    "vehicle.induced_velocity": "m/s",
    "metrics.collision_radius": "m",
    "metrics.hazard_radius": "m",
}


def with_unit(key: str) -> str:
    """A key and, where it has one, its unit in brackets: `wind.drag (1/s)`."""
    return f"{key} ({UNITS[key]})" if key in UNITS else key
