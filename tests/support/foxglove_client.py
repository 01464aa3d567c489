"""A client of Foxglove's WebSocket protocol, on a thread of its own.

github.com/foxglove/foxglove-sdk, docs of the protocol: text messages are JSON with `op`; binary ones begin with their
kind: 1 for a message (subscription and log time, little-endian, then its bytes), 2 for the time of the server.
"""

import asyncio
import json
import struct
import threading
from typing import Any

import aiohttp

PROTOCOL = "foxglove.sdk.v1"
MESSAGE, TIME = 1, 2
LATCHED = "/tf_static"


class FoxgloveClient:
    """Subscribes to all channels that a server has, as any web page may, and keeps what comes until the server goes.

    Attributes:
        server: What the server says of itself.
        channels: The channels, by topic.
        messages: Log time and bytes of the messages, by topic.
        times_ns: The times that the server told.
        subscribed: Set when all channels are subscribed to.
    """

    def __init__(self, port: int) -> None:
        self.server: dict[str, Any] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        self.messages: dict[str, list[tuple[int, bytes]]] = {}
        self.times_ns: list[int] = []
        self.subscribed = threading.Event()
        self._told = threading.Condition()
        self._url = f"http://127.0.0.1:{port}"
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()), daemon=True)
        self._thread.start()

    def wait_for(self, time_ns: int) -> bool:
        """Wait until the server has told this time, and so sent what came before it; False if it never does."""
        with self._told:
            return self._told.wait_for(lambda: time_ns in self.times_ns, 60)

    def join(self) -> None:
        """Wait until the server has gone."""
        self._thread.join()

    async def _run(self) -> None:
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(self._url, protocols=[PROTOCOL], max_msg_size=0, origin="http://a.example") as socket,
        ):
            await self._listen(socket)

    async def _listen(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        topics: dict[int, str] = {}
        async for message in socket:
            if message.type == aiohttp.WSMsgType.TEXT:
                said = json.loads(message.data)
                if said["op"] == "serverInfo":
                    self.server = said
                elif said["op"] == "advertise":
                    self.channels |= {channel["topic"]: channel for channel in said["channels"]}
                    # The one that has a message at once comes last: then all are subscribed to.
                    channels = sorted(said["channels"], key=lambda channel: channel["topic"] == LATCHED)
                    topics |= {channel["id"]: channel["topic"] for channel in channels}
                    wanted = [{"id": channel["id"], "channelId": channel["id"]} for channel in channels]
                    await socket.send_json({"op": "subscribe", "subscriptions": wanted})
            elif message.type == aiohttp.WSMsgType.BINARY and message.data[0] == MESSAGE:
                number, log_time_ns = struct.unpack_from("<IQ", message.data, 1)
                self.messages.setdefault(topics[number], []).append((log_time_ns, message.data[13:]))
                if topics[number] == LATCHED:
                    self.subscribed.set()
            elif message.type == aiohttp.WSMsgType.BINARY and message.data[0] == TIME:
                with self._told:
                    self.times_ns += struct.unpack_from("<Q", message.data, 1)
                    self._told.notify_all()
