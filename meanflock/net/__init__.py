"""The network: the bus in memory and over Zenoh, keys, addresses, access rules, and a node's client."""
