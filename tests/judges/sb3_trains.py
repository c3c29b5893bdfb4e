"""A script for an environment with Stable-Baselines3: trains briefly, and prints as JSON what the test compares.

Arguments: the folder of the examples, the file of the policy, and the number of steps.
"""

import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, sys.argv[1])
import train_sb3

learner = train_sb3.train(uavs=5, steps=int(sys.argv[3]))
policy = train_sb3.save(learner, Path(sys.argv[2]))
rng = np.random.default_rng(3)
rows = train_sb3.SCALE * rng.standard_normal((1000, len(train_sb3.SCALE)))
told, _ = learner.predict((rows / train_sb3.SCALE).astype(np.float32), deterministic=True)
error = np.abs(policy(rows) - train_sb3.ACCELERATION * np.tanh(told.astype(np.float64))).max()
print(json.dumps({"error": float(error), "sha256": policy.sha256, "steps": learner.num_timesteps}))
