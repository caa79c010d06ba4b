import sys
from pathlib import Path

# server_rig, robot_life, primary_structs; importlib mode does not add the folders
sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "codecs")]
