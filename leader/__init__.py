"""The leader: averages the models that arrive. It rides on one UAV and flies with it."""
