"""A ServerApp with secure aggregation, whose clients exchange keys before they train."""

from flower_digits import task
from flwr.app import Context
from flwr.common import ndarrays_to_parameters
from flwr.server import LegacyContext, ServerConfig
from flwr.server.strategy import FedAvg
from flwr.server.workflow import DefaultWorkflow, SecAggPlusWorkflow
from flwr.serverapp import Grid, ServerApp

app = ServerApp()


@app.main()
def main(grid: Grid, context: Context) -> None:
    first = ndarrays_to_parameters(list(task.new_model().values()))
    strategy = FedAvg(fraction_evaluate=0.0, initial_parameters=first)
    legacy = LegacyContext(context=context, config=ServerConfig(num_rounds=3), strategy=strategy)
    DefaultWorkflow(fit_workflow=SecAggPlusWorkflow(num_shares=3, reconstruction_threshold=2))(grid, legacy)
