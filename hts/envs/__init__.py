"""The training environment: the velocity task as a TorchRL env of batch size [P, N]."""
