"""Launch one run: in this process, or as a swarm of processes on this machine."""
