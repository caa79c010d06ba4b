"""Recordings as a dataset of LeRobot (v3.0), which its policies are trained on.

`write_dataset` is the way in. What it writes is what ``lerobot`` itself writes, without it: that brings PyTorch along.
"""

from client.lerobot.dataset import Dataset, write_dataset
from client.lerobot.features import DEFAULT_ACTION, DEFAULT_STATE, Numbers

__all__ = ["DEFAULT_ACTION", "DEFAULT_STATE", "Dataset", "Numbers", "write_dataset"]
