"""Recordings as a LeRobot dataset (v3.0), for training LeRobot's policies.

`write_dataset` is the entry point. It writes the same files as ``lerobot``, but does not need it: installing
``lerobot`` would also install PyTorch.
"""

from client.lerobot.dataset import Dataset, write_dataset
from client.lerobot.features import DEFAULT_ACTION, DEFAULT_STATE, Numbers

__all__ = ["DEFAULT_ACTION", "DEFAULT_STATE", "Dataset", "Numbers", "write_dataset"]
