"""Learner of a PyTorch module: you say what is trained, and this class trains it in flight.

    from meanflock.torch import TorchLearner

    class Digits(TorchLearner):
        name = "digits"
        metrics = ("loss", "accuracy")
        def module(self): return torch.nn.Linear(64, 10)
        def optimizer(self, parameters): return torch.optim.SGD(parameters, lr=0.3)
        def data(self): ...

Parameters that are trained, and buffers, are sent. Parameters without gradients are not: `module` makes the same ones
for every UAV. So a large frozen network with small adapters costs the adapters only. Arrays whose names fit a pattern
of `keeps` stay with the UAV: personal layers.
"""

import io
from collections.abc import Iterable, Sized
from typing import Any, ClassVar, cast

from meanflock.agent.learning.base import Fit, Learner, Trained, Tree
from meanflock.swarm import threads
from meanflock.swarm.errors import available
from meanflock.swarm.scenario import Scenario

with available("meanflock.torch", "torch"), threads.pinned_torch():
    import torch
    from torch.utils.data import DataLoader

_TESTS = 256  # examples of a batch
_ROOM = 1.1  # of the state of an optimiser, whose numbers are stored in more or fewer digits


class TorchLearner(Learner):
    """Base class of learners in PyTorch: override `module`, `optimizer` and `data`; declare what differs from these.

    Attributes:
        epochs: passes over the data in a training. batch: examples of a step.
        keeps_optimizer: whether the state of the optimiser goes on from one training to the next, in checkpoints too.
        net: the module of this UAV.
    """

    epochs: int = 1
    batch: int = 32
    keeps_optimizer: bool = False
    loss: ClassVar[Any] = staticmethod(torch.nn.functional.cross_entropy)  # of outputs and targets

    def __init__(self, options: Any, scenario: Scenario, uav: int) -> None:
        super().__init__(options, scenario, uav)
        self.net = self._made()
        self._optimizer = self.optimizer(self._trained())
        self._fresh = self._optimizer.state_dict()
        self._data, self._tests = self.data(), self.tests()
        if not isinstance(self._data, Sized):
            raise TypeError(f"`data` returns a {type(self._data).__name__}; expected a data set with a length")

    def module(self) -> torch.nn.Module:
        """Returns the module, with its first weights; torch is seeded alike for all UAVs. Only `options` and
        `scenario` may be used."""
        raise NotImplementedError("override `module`")

    def optimizer(self, parameters: Iterable[torch.nn.Parameter]) -> torch.optim.Optimizer:
        """Returns an optimiser of the parameters."""
        raise NotImplementedError("override `optimizer`")

    def data(self) -> Any:
        """Returns the training data of this UAV, a data set of pairs (input, target). A UAV without examples trains
        nothing and sends nothing."""
        raise NotImplementedError("override `data`")

    def tests(self) -> Any:
        """Returns the data set on which `accuracy` is measured; None: the training data."""
        return None

    @classmethod
    def initial(cls, options: Any, scenario: Scenario) -> Tree:
        """See `Learner.initial`. If the state of the optimiser is kept, this sets `state_bytes`, too."""
        blank = cls.__new__(cls)
        Learner.__init__(blank, options, scenario, -1)
        blank.net = blank._made()
        tree = blank._tree()
        if cls.keeps_optimizer:
            optimizer = blank._optimizer = blank.optimizer(blank._trained())
            for parameter in blank._trained():
                parameter.grad = torch.zeros_like(parameter)
            optimizer.step()
            cls.state_bytes = int(_ROOM * len(blank.state())) + 1024
        return tree

    def fit(self, model: Tree, config: Fit) -> Trained | None:
        """See `Learner.fit`: so many epochs of the loss, over the data in random order."""
        if not (examples := len(self._data)):
            return None
        self._take(model)
        self.net.train()
        total = 0.0
        for _ in range(self.epochs):
            total = 0.0
            for inputs, targets in DataLoader(self._data, self.batch, shuffle=True):
                self._optimizer.zero_grad()
                loss = type(self).loss(self.net(inputs), targets)
                loss.backward()
                self._optimizer.step()
                total += loss.item() * len(targets)
        return Trained(self._tree(), examples, {"loss": total / examples})

    def evaluate(self, model: Tree, config: Fit) -> dict[str, float]:
        """See `Learner.evaluate`: the share of the test data whose largest output is that of the target."""
        data = self._data if self._tests is None else self._tests
        if "accuracy" not in self.metrics or not len(data):
            return {}
        self._take(model)
        self.net.eval()
        with torch.no_grad():
            right = [(self.net(inputs).argmax(-1) == targets).sum() for inputs, targets in DataLoader(data, _TESTS)]
        return {"accuracy": int(sum(right)) / len(data)}

    def state(self) -> bytes:
        """See `Learner.state`: the state of the optimiser, if it is kept."""
        if not self.keeps_optimizer:
            return b""
        file = io.BytesIO()
        torch.save(self._optimizer.state_dict(), file)
        return file.getvalue()

    def load(self, raw: bytes) -> None:
        """See `Learner.load`."""
        state = torch.load(io.BytesIO(raw), weights_only=True) if raw else self._fresh
        self._optimizer.load_state_dict(state)

    def _made(self) -> torch.nn.Module:
        torch.manual_seed(self.scenario.seed)
        return self.module()

    def _trained(self) -> list[torch.nn.Parameter]:
        return [parameter for parameter in self.net.parameters() if parameter.requires_grad]

    def _tree(self) -> Tree:
        """The parameters that are trained, and the buffers, by name."""
        frozen = {name for name, parameter in self.net.named_parameters() if not parameter.requires_grad}
        return {name: tensor.clone() for name, tensor in self.net.state_dict().items() if name not in frozen}

    def _take(self, model: Tree) -> None:
        tensors = {name: torch.as_tensor(array) for name, array in cast(dict[str, Any], model).items()}
        self.net.load_state_dict(tensors, strict=False)
