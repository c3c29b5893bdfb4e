"""Handwritten digits: each UAV has seen two of ten, and they train one network of PyTorch in flight.

meanflock run --method plan --learner examples/digits.py --uavs 10 --set federation.fraction=1
"""

import torch
from sklearn.datasets import load_digits

from meanflock.torch import TorchLearner


class Digits(TorchLearner):
    name = "digits"
    metrics = ("loss", "accuracy")

    def module(self):
        return torch.nn.Sequential(torch.nn.Linear(64, 32), torch.nn.Tanh(), torch.nn.Linear(32, 10))

    def optimizer(self, parameters):
        return torch.optim.SGD(parameters, lr=0.3)

    def data(self):
        images, digits = self.pictures(held_out=False)
        mine = (digits == self.uav % 10) | (digits == (self.uav + 1) % 10)
        return torch.utils.data.TensorDataset(images[mine], digits[mine])

    def tests(self):
        return torch.utils.data.TensorDataset(*self.pictures(held_out=True))

    def pictures(self, held_out):
        images, digits = (torch.as_tensor(array) for array in load_digits(return_X_y=True))
        chosen = (torch.arange(len(digits)) % 5 == 0) == held_out  # nobody trains on every fifth
        return images[chosen].float() / 16, digits[chosen]
