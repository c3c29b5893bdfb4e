"""The Rerun recording of a flight: made of its telemetry, shown, and rendered."""
