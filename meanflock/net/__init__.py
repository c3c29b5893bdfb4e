"""The network: bus, Zenoh, keys, access rules, processes, a node's client, and the crew of nodes on a bus."""
