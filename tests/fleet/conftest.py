import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # fleet_rig; importlib mode does not add the folder
