"""The gripper of ``--gripper`` as a peer: the software on the controller that programs talk to on TCP port 63352."""

from collections.abc import Iterator
from dataclasses import dataclass, field

from emulator.devices.gripper_requests import GripperSession
from emulator.devices.robotiq import Gripper
from emulator.peers.answers import Reply, cut_all
from emulator.peers.log import PeerLog
from urproto.robotiq import RequestDecoder
from urproto.text import from_bytes, strip


@dataclass
class GripperPeer:
    """Answers for the gripper. A request with a line end is answered in another form than one without."""

    log: PeerLog
    gripper: Gripper
    session: GripperSession = field(default_factory=GripperSession)

    def cut(self, buffer: bytearray, idle: bool) -> Iterator[bytes]:
        while (end := buffer.find(b"\n") + 1) > 0:
            yield bytes(buffer[:end])
            del buffer[:end]
        if idle:
            yield from cut_all(buffer)

    def answer(self, message: bytes) -> Reply:
        self.log.add(strip(from_bytes(message)))
        decoder = RequestDecoder()
        return Reply(self.session.answer(self.gripper, (*decoder.feed(message), *decoder.flush())))
