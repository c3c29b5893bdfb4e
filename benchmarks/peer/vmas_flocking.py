"""vmas: one step of its flocking scenario, one environment of N agents on one thread of a CPU. `vmas_flocking.py N`."""

import sys

import torch
import vmas
from serve import serve

torch.set_num_threads(1)
env = vmas.make_env(scenario="flocking", num_envs=1, n_agents=int(sys.argv[1]), device="cpu", continuous_actions=True)
env.reset()
still = [torch.zeros(1, env.get_agent_action_size(agent)) for agent in env.agents]
serve(lambda: env.step(still))
