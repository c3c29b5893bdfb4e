"""The radio between UAVs, emulated: Rice fading, slots, latency, outages, and what all of it costs."""
