"""A client of the Debug Adapter Protocol for tests."""

import json
import subprocess
import sys

CELL = """def cell():
  global count = 0
  def move(x):
    y = x * 2
    movej([0.1 * x, -1.4, 1.5, -1.7, -1.5, 0.1 * random()], a=3, v=2)
    return y
  end
  thread blink():
    while True:
      set_standard_digital_out(1, count > 1)
      sleep(0.1)
    end
  end
  run blink()
  while count < 4:
    z = move(count)
    textmsg("z ", z)
    count = count + 1
  end
  sleep(0.5)
end
"""


class DebugClient:
    """A session with ``urscript dap`` in a process of its own."""

    def __init__(self):
        command = [sys.executable, "-m", "urscript", "dap"]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        self.events = []
        self.thread = 1
        self._sequence = 0

    def launch(self, program, breakpoints=(), functions=(), **options):
        self.request("initialize", adapterID="test")
        self.request("launch", program=str(program), **{"model": "ur5e", **options})
        self.request("setBreakpoints", source={"path": str(program)}, breakpoints=list(breakpoints))
        self.request("setFunctionBreakpoints", breakpoints=[{"name": name} for name in functions])
        self.send("configurationDone")
        return self

    def send(self, command, **arguments):
        self._sequence += 1
        message = {"seq": self._sequence, "type": "request", "command": command, "arguments": arguments}
        self.write(json.dumps(message).encode())
        return self._sequence

    def write(self, data):
        self.process.stdin.write(b"Content-Length: %d\r\n\r\n%b" % (len(data), data))
        self.process.stdin.flush()

    def read(self):
        length = 0
        while (line := self.process.stdout.readline()) != b"\r\n":
            assert line, self.process.stderr.read().decode()
            length = int(line.split(b":")[1])
        message = json.loads(self.process.stdout.read(length))
        if message["type"] == "event":
            self.events.append((message["event"], message["body"]))
        return message

    def answer(self, command, **arguments):
        """The whole response."""
        number = self.send(command, **arguments)
        while (message := self.read())["type"] != "response" or message["request_seq"] != number:
            pass
        return message

    def request(self, command, **arguments):
        response = self.answer(command, **arguments)
        assert response["success"], response
        return response["body"]

    def until(self, *names):
        while True:
            message = self.read()
            if message["type"] == "event" and message["event"] in names:
                self.thread = message["body"].get("threadId", self.thread)
                return message["body"]

    def go(self, command="continue"):
        """Let the program go on, or back; returns why it has stopped and where."""
        self.send(command, threadId=self.thread)
        return self.stopped()

    def stopped(self):
        body = self.until("stopped", "terminated")
        return (body["reason"], self.place()) if body else ("terminated", None)

    def place(self):
        frames = self.request("stackTrace", threadId=self.thread)["stackFrames"]
        self.frame = frames[0]["id"] if frames else 0
        return [(frame["name"], frame["line"]) for frame in frames]

    def variables(self, reference=1):
        found = self.request("variables", variablesReference=reference)["variables"]
        return {one["name"]: one["value"] for one in found}

    @property
    def said(self):
        return "".join(body["output"] for name, body in self.events if name == "output")

    def close(self):
        """End the session; nothing may be left."""
        try:
            if self.process.poll() is None:
                self.request("disconnect")
            assert self.process.wait(30) == 0, self.process.stderr.read().decode()
        finally:
            self.process.kill()
            self.process.communicate()
