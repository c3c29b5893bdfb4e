"""Controllers that choose way and speed by the wind, known or mapped in flight."""
