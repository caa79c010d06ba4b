"""``ur-client doctor``: whether this machine, the network and the robot are fit to work together."""
