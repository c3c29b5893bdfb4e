"""The paper's methods and the baseline, by name, with what each shares and learns."""

METHODS = ("hjb", "mfg", "mfgfl-h", "mfgfl-f", "mfgfl-hf", "offline")
PARTS = {"mfgfl-h": (54, 54), "mfgfl-f": (69, 69), "mfgfl-hf": (54, 54, 69, 69)}  # floats of each part that is shared
FEDERATED = tuple(PARTS)
