"""Serves the frames of a run over Foxglove's WebSocket protocol, with the topics and messages of the MCAP output."""

import logging
import socket
import threading
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

import foxglove
from foxglove.websocket import Capability, ChannelView, Client, ServerListener, WebSocketServer

from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import Drop
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.writers.base import ResultWriter
from lidcam.writers.mcap.output import Buffer, MessageSink
from lidcam.writers.mcap.writer import ResultMessages

LATCHED = "/tf_static"
"""Topic that has one message, which whoever subscribes later gets, too."""

STOP_S = 1.0
"""Seconds that clients have to leave a server that stops."""


class FoxgloveServer(ResultWriter):
    """A server that runs while the block does.

    Whoever connects gets the frames from then on, under a title. One that is too slow misses messages, and never holds
    up the run. `frames` are as of `ResultMessages`.
    """

    name = "foxglove"
    path = Path("--foxglove")

    def __init__(
        self, host: str, port: int, title: str, rig: Rig, config: Config, *, frames: Sequence[Transform] = ()
    ) -> None:
        self._host, self._port, self._title = host, port, title
        self._rig, self._config, self._frames = rig, config, frames
        self._server: WebSocketServer
        self._messages: ResultMessages

    def _open(self, resources: ExitStack) -> None:
        context = foxglove.Context()
        channels = _Channels(context)
        logging.getLogger("foxglove").setLevel(logging.CRITICAL)  # what clients do wrong is no error of the run
        # Before the server: it takes no subscription to a channel that is made in the same moment.
        self._messages = ResultMessages(channels, self.path, self._rig, self._config, self._frames)
        try:
            self._server = foxglove.start_server(
                name=self._title,
                host=self._host,
                port=self._port,
                context=context,
                server_listener=channels,
                capabilities=[Capability.Time],
            )
        except RuntimeError as err:
            raise OutputError(f"foxglove: expected a free port, found {self._host}:{self._port} ({err})") from err
        resources.callback(_stop, self._server)

    def _finish(self) -> None:
        self._messages.finish()

    def write(self, result: FrameResult) -> tuple[Drop, ...]:
        """Send one frame, and its time."""
        drops = self._messages.add_frame(result)
        self._server.broadcast_time(result.bundle.log_time_ns)
        return drops


def _stop(server: WebSocketServer) -> None:
    """Stop a server within seconds: by itself it waits for silent clients, and for slow ones, without end."""
    port = server.port
    stopping = threading.Thread(target=server.stop, name="lidcam-foxglove", daemon=True)
    stopping.start()
    stopping.join(STOP_S)
    if stopping.is_alive():
        _shut_connections(port)
        stopping.join(10 * STOP_S)  # a moment, but on a busy machine


def _shut_connections(port: int) -> None:
    """Shut the connections of this process at one of its ports; the library has no way to do so."""
    for path in Path("/dev/fd").iterdir():
        if path.is_socket():
            with suppress(OSError), socket.fromfd(int(path.name), socket.AF_INET, socket.SOCK_STREAM) as one:
                if one.getsockname()[1:2] == (port,):
                    one.shutdown(socket.SHUT_RDWR)


class _Channels(MessageSink, ServerListener):
    """The channels of a server. The server calls `on_subscribe` from a thread of its own."""

    def __init__(self, context: foxglove.Context) -> None:
        self._context = context
        self._channels: dict[int, foxglove.Channel] = {}
        self._latched: tuple[bytes, int] | None = None

    def add_channel(
        self, topic: str, encoding: str, schema: tuple[str, str, bytes], metadata: Mapping[str, str]
    ) -> int:
        name, schema_encoding, data = schema
        channel = foxglove.Channel(
            topic,
            schema=foxglove.Schema(name=name, encoding=schema_encoding, data=data),
            message_encoding=encoding,
            metadata=dict(metadata),
            context=self._context,
        )
        self._channels[channel.id()] = channel
        return channel.id()

    def add_message(self, channel: int, log_time_ns: int, data: Buffer, sequence: int = 0) -> None:  # noqa: ARG002
        to = self._channels[channel]
        if to.topic() == LATCHED:
            self._latched = bytes(data), log_time_ns
        if to.has_sinks():
            to.log(bytes(data), log_time=log_time_ns)

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:  # noqa: ARG002
        if channel.topic == LATCHED and self._latched is not None:
            data, log_time_ns = self._latched
            self._channels[channel.id].log(data, log_time=log_time_ns)
