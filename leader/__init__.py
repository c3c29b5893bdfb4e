"""The leader node: averages uploads and broadcasts the global model. It is on board of one UAV."""
