"""rclpy, as far as the nodes use it: a graph inside one process, with names, remaps, parameters and an executor of one
thread, as the true one behaves (docs of rclpy for Jazzy). Transforms are in `fake_tf2`."""

import copy
import heapq
import itertools
import time
import types
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any

from tests.ros2.interfaces import made, message

RELIABLE, BEST_EFFORT = "reliable", "best effort"


class QoS:
    def __init__(self, depth: int, reliability: str = RELIABLE) -> None:
        self.depth, self.reliability = depth, reliability


SENSOR_DATA = QoS(5, BEST_EFFORT)


class ExternalShutdownException(Exception):
    pass


class ClockType:
    ROS_TIME = "ros"


class Time:
    def __init__(self, *, seconds: float = 0, nanoseconds: int = 0, clock_type: str = "system") -> None:
        self.nanoseconds = int(seconds * 10**9) + nanoseconds
        self.clock_type = clock_type

    def to_msg(self) -> Any:
        sec, nanosec = divmod(self.nanoseconds, 10**9)
        return message("builtin_interfaces/Time", sec=sec, nanosec=nanosec)


class Clock:
    clock_type = ClockType.ROS_TIME

    def now(self) -> Time:
        return Time(nanoseconds=time.time_ns(), clock_type=self.clock_type)


class Logger:
    def __init__(self, lines: list[tuple[str, str]]) -> None:
        self._lines = lines

    def __getattr__(self, level: str) -> Callable[[str], None]:
        assert level in ("debug", "info", "warning", "error", "fatal"), level
        return lambda text: self._lines.append((level, text))


class Graph:
    """All nodes of a test, their executor, and what they said."""

    def __init__(self) -> None:
        self.parameters: dict[str, dict[str, Any]] = {}
        self.remaps: dict[str, dict[str, str]] = {}
        self.namespace = "/"
        self.lines: list[tuple[str, str]] = []
        self.published: dict[str, list[Any]] = defaultdict(list)
        self.subscriptions: dict[str, list[tuple[Any, Callable[[Any], None], QoS]]] = defaultdict(list)
        self.services: dict[str, tuple[Any, Callable[[Any, Any], Any]]] = {}
        self.hanging: dict[str, list[Any]] = {}
        """Services that take calls and never answer, with what they took."""
        self.nodes: list[Node] = []
        self.longest_s = 0.0
        self._ready: SimpleQueue[tuple[Callable[..., None], tuple[Any, ...]]] = SimpleQueue()
        self._timers: list[tuple[float, int, float, Callable[[], None], Node]] = []
        self._numbers = itertools.count()

    def soon(self, callback: Callable[..., None], *arguments: Any) -> None:
        """Run a callback in the executor; from any thread."""
        self._ready.put((callback, arguments))

    def every(self, period: float, callback: Callable[[], None], node: "Node") -> None:
        heapq.heappush(self._timers, (time.monotonic() + period, next(self._numbers), period, callback, node))

    def publish(self, topic: str, kind: Any, given: Any, reliability: str) -> None:
        assert isinstance(given, kind), f"{topic} takes {kind}"
        self.published[topic].append(copy.deepcopy(given))
        for wanted, callback, qos in self.subscriptions[topic]:
            assert wanted is kind, f"{topic}: types do not match"
            if not (reliability == BEST_EFFORT and qos.reliability == RELIABLE):  # incompatible: nothing arrives
                self.soon(callback, copy.deepcopy(given))

    def call(self, service: str, request: Any) -> "Future":
        future = Future()

        def answer() -> None:
            kind, callback = self.services[service]
            future.set_result(callback(request, kind.Response()))

        if service in self.hanging:
            self.hanging[service].append(request)
        elif service in self.services:
            self.soon(answer)
        return future

    def spin_once(self, timeout: float = 0.05) -> None:
        now = time.monotonic()
        until = min(self._timers[0][0], now + timeout) if self._timers else now + timeout
        with suppress(Empty):
            callback, arguments = self._ready.get(timeout=max(0.001, until - now))
            self._run(callback, *arguments)
            for _ in range(self._ready.qsize()):
                callback, arguments = self._ready.get()
                self._run(callback, *arguments)
        while self._timers and self._timers[0][0] <= time.monotonic():
            _, _, period, callback, node = heapq.heappop(self._timers)
            if node in self.nodes:
                self._run(callback)
                self.every(period, callback, node)

    def _run(self, callback: Callable[..., None], *arguments: Any) -> None:
        began = time.monotonic()
        callback(*arguments)
        self.longest_s = max(self.longest_s, time.monotonic() - began)

    def until(self, true: Callable[[], Any], seconds: float = 60.0) -> None:
        """Spin until something holds."""
        end = time.monotonic() + seconds
        while not true():
            assert time.monotonic() < end, f"it never came: {self.lines[-5:]}"
            self.spin_once()


graph = Graph()


def fresh() -> Graph:
    """Another graph, for a test of its own."""
    global graph
    graph = Graph()
    return graph


class Future:
    def __init__(self) -> None:
        self._result: Any = None
        self._done = False
        self._exception: Exception | None = None
        self._then: list[Callable[[Future], None]] = []

    def set_result(self, result: Any) -> None:
        self._result, self._done = result, True
        for callback in self._then:
            graph.soon(callback, self)

    def set_exception(self, exception: Exception) -> None:
        self._exception = exception
        self.set_result(None)

    def add_done_callback(self, callback: Callable[["Future"], None]) -> None:
        if self._done:
            graph.soon(callback, self)
        else:
            self._then.append(callback)

    def cancelled(self) -> bool:
        return False

    def exception(self) -> Exception | None:
        return self._exception

    def result(self) -> Any:
        return self._result


class Publisher:
    def __init__(self, kind: Any, topic: str, qos: QoS) -> None:
        self._kind, self.topic, self._qos = kind, topic, qos

    def publish(self, given: Any) -> None:
        graph.publish(self.topic, self._kind, given, self._qos.reliability)

    def get_subscription_count(self) -> int:
        return len(graph.subscriptions[self.topic])


class Client:
    def __init__(self, kind: Any, service: str) -> None:
        self._kind, self._service = kind, service
        self.pending: list[Future] = []

    def service_is_ready(self) -> bool:
        return self._service in graph.services or self._service in graph.hanging

    def call_async(self, request: Any) -> Future:
        assert isinstance(request, self._kind.Request)
        future = graph.call(self._service, request)
        self.pending.append(future)
        return future

    def remove_pending_request(self, future: Future) -> None:
        self.pending.remove(future)


class Node:
    def __init__(self, name: str) -> None:
        self._name = name
        self._overrides = graph.parameters.get(name, {})
        self._remaps = graph.remaps.get(name, {})
        self.fake_declared: set[str] = set()
        graph.nodes.append(self)

    def get_fully_qualified_name(self) -> str:
        return f"{graph.namespace.rstrip('/')}/{self._name}"

    def resolve_topic_name(self, topic: str) -> str:
        topic = self._remaps.get(topic, topic)
        if topic.startswith("/"):
            return topic
        if topic.startswith("~/"):
            return f"{self.get_fully_qualified_name()}/{topic[2:]}"
        return f"{graph.namespace.rstrip('/')}/{topic}"

    def declare_parameter(self, name: str, value: Any, descriptor: Any) -> Any:
        assert name not in self.fake_declared, f"{name} is declared twice"
        assert isinstance(descriptor, made["rcl_interfaces/ParameterDescriptor"])
        self.fake_declared.add(name)
        given = self._overrides.get(name, value)
        if type(given) is not type(value) and not descriptor.dynamic_typing:
            raise TypeError(f"{name}: InvalidParameterTypeException")
        return types.SimpleNamespace(value=given)

    def create_publisher(self, kind: Any, topic: str, qos: QoS | int) -> Publisher:
        return Publisher(kind, self.resolve_topic_name(topic), QoS(qos) if isinstance(qos, int) else qos)

    def create_subscription(self, kind: Any, topic: str, callback: Callable[[Any], None], qos: QoS | int) -> Any:
        entry = (kind, callback, QoS(qos) if isinstance(qos, int) else qos)
        graph.subscriptions[self.resolve_topic_name(topic)].append(entry)
        return entry

    def create_service(self, kind: Any, service: str, callback: Callable[[Any, Any], Any]) -> Any:
        graph.services[self.resolve_topic_name(service)] = (kind, callback)
        return service

    def create_client(self, kind: Any, service: str) -> Client:
        return Client(kind, self.resolve_topic_name(service))

    def create_timer(self, period: float, callback: Callable[[], None]) -> Any:
        graph.every(period, callback, self)
        return callback

    def create_guard_condition(self, callback: Callable[[], None]) -> Any:
        return types.SimpleNamespace(trigger=lambda: graph.soon(callback))

    def get_logger(self) -> Logger:
        return Logger(graph.lines)

    def get_clock(self) -> Clock:
        return Clock()

    def destroy_node(self) -> None:
        graph.nodes.remove(self)
        graph.subscriptions.clear()


def modules() -> dict[str, types.ModuleType]:
    """rclpy and its parts, by name, as ``sys.modules`` has them."""
    contents: dict[str, dict[str, Any]] = {
        "rclpy": {
            "init": lambda: None,
            "spin": lambda node: graph.until(lambda: False),
            "try_shutdown": lambda: None,
        },
        "rclpy.executors": {"ExternalShutdownException": ExternalShutdownException},
        "rclpy.logging": {"get_logger": lambda name: Logger(graph.lines)},
        "rclpy.node": {"Node": Node},
        "rclpy.qos": {"qos_profile_sensor_data": SENSOR_DATA},
        "rclpy.time": {"Time": Time},
    }
    found = {}
    for name, entries in contents.items():
        found[name] = types.ModuleType(name)
        vars(found[name]).update(entries)
    return found
