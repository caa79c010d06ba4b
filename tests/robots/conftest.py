import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # kinematics_oracle; importlib mode does not add the folder
