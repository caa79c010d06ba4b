"""The PLC of the sorting line: it presents the next part when the robot reports that it has finished one."""

PART_THERE, LINE_RUNS, ROBOT_DONE = 0, 1, 16
PART_TYPE, PARTS_SORTED = 128, 129


class Line:
    """A line with four parts of types 0, 1, 7 and 1."""

    def __init__(self) -> None:
        self.parts = [0, 1, 7, 1]
        self.coils = {PART_THERE: 1, LINE_RUNS: 1, ROBOT_DONE: 0}
        self.registers = {PART_TYPE: self.parts[0], PARTS_SORTED: 0}

    def written(self, kind: str, address: int, value: int) -> None:
        """The robot has written a value."""
        if (kind, address, value) == ("coil", ROBOT_DONE, 1):
            del self.parts[0]
            self.coils[PART_THERE] = self.coils[LINE_RUNS] = int(bool(self.parts))
            self.registers[PART_TYPE] = self.parts[0] if self.parts else 0
