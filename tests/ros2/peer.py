"""A plain rclpy program: asks what it is told to on standard input, a JSON object a line, and answers with one each.

{"call": service, "type": ..., "request": {...}}         the response
{"goal": action, "type": ..., "goal": {...}}             accepted; {"result": action} waits, {"cancel": action} cancels;
                                                         "last": {...} of a result: that the last feedback says, too,
                                                         which takes another way and may come later
{"echo": topic, "type": ..., "latched": bool}            the next message
{"publish": topic, "type": ..., "message": {...}}        after somebody listens; "latched": true for those to come
{"graph": true}                                          topics, services and their types; those of each node
"""

import array
import json
import sys
import time
from importlib import import_module

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

PATIENCE_S = 60.0


def interface(name):
    package, kind, type_name = name.split("/")
    return getattr(import_module(f"{package}.{kind}"), type_name)


def plain(value):
    """A message as JSON has it."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, array.array | list | tuple) or type(value).__name__ == "ndarray":
        return [plain(item) for item in value]
    return value.item() if hasattr(value, "item") else value  # of numpy


def fill(message, values):
    for name, value in values.items():
        now = getattr(message, name)
        if isinstance(value, dict):
            fill(now, value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            kind = message.get_fields_and_field_types()[name].removeprefix("sequence<").split(">")[0].split("[")[0]
            package, type_name = kind.split("/")
            setattr(message, name, [fill(interface(f"{package}/msg/{type_name}")(), item) for item in value])
        elif isinstance(now, bytes):  # a byte, by its constant's name or as it is
            setattr(message, name, getattr(message, value) if isinstance(value, str) else bytes([value]))
        else:
            setattr(message, name, value)
    return message


class Peer:
    def __init__(self):
        rclpy.init()
        self.node = Node("peer")
        self.clients = {}
        self.goals = {}
        self.subscriptions = {}

    def wait(self, future):
        rclpy.spin_until_future_complete(self.node, future, timeout_sec=PATIENCE_S)
        assert future.done(), "no answer"
        return future.result()

    def call(self, order):
        kind = interface(order["type"])
        key = order["call"]
        if key not in self.clients:
            self.clients[key] = self.node.create_client(kind, key)
        assert self.clients[key].wait_for_service(PATIENCE_S), f"there is no service {key}"
        return plain(self.wait(self.clients[key].call_async(fill(kind.Request(), order.get("request", {})))))

    def goal(self, order):
        kind = interface(order["type"])
        key = order["goal"]
        if key not in self.clients:
            self.clients[key] = ActionClient(self.node, kind, key)
        assert self.clients[key].wait_for_server(PATIENCE_S), f"there is no action {key}"
        feedback = []
        handle = self.wait(
            self.clients[key].send_goal_async(
                fill(kind.Goal(), order.get("request", {})), lambda message: feedback.append(plain(message.feedback))
            )
        )
        if handle.accepted:
            self.goals[key] = handle, handle.get_result_async(), feedback
        return {"accepted": handle.accepted}

    def result(self, order):
        _, future, feedback = self.goals[order["result"]]
        answer = self.wait(future)
        end_s = time.monotonic() + PATIENCE_S
        while not order.get("last", {}).items() <= (feedback[-1] if feedback else {}).items():
            assert time.monotonic() < end_s, f"the last feedback is {feedback[-1:]}"
            rclpy.spin_once(self.node, timeout_sec=0.05)
        return {
            "status": answer.status,
            "result": plain(answer.result),
            "feedback": feedback[-1:],
            "feedback_messages": len(feedback),
        }

    def cancel(self, order):
        handle, _, _ = self.goals[order["cancel"]]
        return plain(self.wait(handle.cancel_goal_async()))

    def echo(self, order):
        key, kind = order["echo"], interface(order["type"])
        if key not in self.subscriptions:
            durability = DurabilityPolicy.TRANSIENT_LOCAL if order.get("latched") else DurabilityPolicy.VOLATILE
            quality = QoSProfile(depth=10, durability=durability)
            messages = []
            self.subscriptions[key] = messages, self.node.create_subscription(kind, key, messages.append, quality)
        messages, _ = self.subscriptions[key]
        messages.clear() if order.get("new") else None
        end_s = time.monotonic() + PATIENCE_S
        while not messages and time.monotonic() < end_s:
            rclpy.spin_once(self.node, timeout_sec=0.1)
        assert messages, f"nothing comes on {key}"
        return plain(messages.pop(0))

    def publish(self, order):
        key, kind = order["publish"], interface(order["type"])
        if key not in self.clients:
            durability = DurabilityPolicy.TRANSIENT_LOCAL if order.get("latched") else DurabilityPolicy.VOLATILE
            quality = QoSProfile(depth=1, durability=durability)
            self.clients[key] = self.node.create_publisher(kind, key, quality)
        end_s = time.monotonic() + PATIENCE_S
        while not order.get("latched") and self.clients[key].get_subscription_count() == 0 and time.monotonic() < end_s:
            rclpy.spin_once(self.node, timeout_sec=0.05)
        self.clients[key].publish(fill(kind(), order["message"]))
        return {}

    def graph(self, order):
        nodes = {
            f"{space.rstrip('/')}/{name}": {
                "publishes": dict(self.node.get_publisher_names_and_types_by_node(name, space)),
                "listens": dict(self.node.get_subscriber_names_and_types_by_node(name, space)),
                "services": dict(self.node.get_service_names_and_types_by_node(name, space)),
            }
            for name, space in self.node.get_node_names_and_namespaces()
        }
        return {
            "nodes": nodes,
            "topics": dict(self.node.get_topic_names_and_types()),
            "services": dict(self.node.get_service_names_and_types()),
        }


def main():
    peer = Peer()
    for line in sys.stdin:
        order = json.loads(line)
        verb = next(iter(order))
        try:
            answer = getattr(peer, verb)(order)
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
