"""Messages of browsers to the viewer's server: any bytes, and messages of viser with other values."""

from __future__ import annotations

import random
import time
import urllib.request
from typing import Any

import pytest

from neural_renderer.apps.view.viewer import Viewer
from neural_renderer.meshes.mesh import Mesh
from tests.fuzz.edits import changed
from tests.mutations import plain

VALUES = (
    None,
    True,
    -1,
    0,
    1e39,
    float("nan"),
    "",
    "x" * 300,
    b"\0" * 9,
    [],
    [0.0] * 3,
    [1] * 4,
    {},
    {"a": [{}]},
    2**63,
)
FIELDS = ("uuid", "updates", "name", "instance_index", "ray_origin", "ray_direction", "screen_pos", "event_type", "fov")
FIELDS += (
    "wxyz",
    "position",
    "near",
    "far",
    "image_height",
    "image_width",
    "look_at",
    "up_direction",
    "payload",
    "done",
)


class MessagesFuzzer:
    """Sends messages to a viewer: afterwards it still shows its page."""

    def __init__(self) -> None:
        viser = pytest.importorskip("viser")
        from viser import _messages
        from websockets.sync.client import connect

        self._viewer, self._connect = Viewer(port=0), connect
        self._viewer.show(Mesh.icosphere(0), "ball")
        self._protocol: Any = f"viser-v{viser.__version__}"
        self._types = sorted(kind.__name__ for kind in _messages.Message.get_subclasses())

    def draw(self, rng: random.Random) -> tuple[str, bytes]:
        """Make a message."""
        import msgspec.msgpack

        kind = rng.choice([*self._types, "ViewerCameraMessage", "GuiUpdateMessage"])
        fields = {name: rng.choice(VALUES) for name in rng.sample(FIELDS, rng.randint(0, len(FIELDS)))}
        if kind == "ViewerCameraMessage":
            numbers = ([0.0] * 3, [1e30] * 3, [float("nan")] * 3)
            fields |= {name: rng.choice(numbers) for name in ("position", "look_at", "up_direction")}
            fields |= {"wxyz": [1.0, 0, 0, 0], "fov": rng.choice((0.0, 1.0, -1.0)), "near": 0.1, "far": 9.0}
            fields |= {"image_height": rng.choice((0, 9, 10**9)), "image_width": rng.choice((0, 9))}
        message = msgspec.msgpack.encode({"type": kind, **fields})
        return "message", changed(message, [plain], rng) if rng.random() < 0.5 else message

    def run(self, name: str, data: bytes) -> None:
        """Send a message; a new browser gets the page, within seconds."""
        address = str(self._viewer.url)
        socket = address.replace("http", "ws", 1)
        with self._connect(socket, subprotocols=[self._protocol], open_timeout=30, close_timeout=1) as connection:
            connection.send(data)
            time.sleep(0.01)
        with urllib.request.urlopen(address, timeout=30) as page:
            assert page.status == 200 and page.read(100)

    def close(self) -> None:
        """End the viewer."""
        self._viewer.close()
