"""The mean-field limit: how swarms of N UAVs approach a swarm of 100,000, and what one UAV gains by deviating."""
