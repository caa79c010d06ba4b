import sys
from pathlib import Path

# fuzz, targets, server_rig, tree_rig; importlib mode does not add the folders
sys.path[:0] = [str(Path(__file__).parents[1] / folder) for folder in ("fuzzing", "servers", "programs")]
