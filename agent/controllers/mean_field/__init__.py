"""The paper's methods and what only they use: features, learners, the open-loop plan; `kernels/mean_field` computes."""
