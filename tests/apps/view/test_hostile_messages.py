"""Requests and messages that no browser of ours sends."""

from __future__ import annotations

import http.client
import random
import time
from urllib.parse import urlsplit

import pytest

from tests.fuzz.messages import MessagesFuzzer


@pytest.fixture
def fuzzer() -> MessagesFuzzer:
    pytest.importorskip("viser")
    return MessagesFuzzer()


def test_garbage_puts_nothing_on_the_terminal(fuzzer: MessagesFuzzer, capfd: pytest.CaptureFixture[str]) -> None:
    import msgspec.msgpack

    camera = {"type": "ViewerCameraMessage", "wxyz": [1.0, 0, 0, 0], "position": [0.0] * 3, "fov": 0.0, "near": 0.1}
    camera |= {"far": 9.0, "image_height": 0, "image_width": 9, "look_at": [0.0] * 3, "up_direction": [0.0] * 3}
    texts = [{}, {"type": "Unknown"}, {"type": "GuiUpdateMessage", "uuid": "x", "updates": {"value": 1}}, camera, [], 7]
    rng = random.Random(0)
    try:
        frames = [msgspec.msgpack.encode(text) for text in texts]
        for frame in [b"", b"\xff" * 9, *frames, *(fuzzer.draw(rng)[1] for _ in range(20))]:
            fuzzer.run("message", frame)
        time.sleep(0.5)
    finally:
        fuzzer.close()
    told = "".join(capfd.readouterr())
    assert "Traceback" not in told and "Error" not in told, told


def test_long_addresses_are_refused(fuzzer: MessagesFuzzer) -> None:
    place = urlsplit(fuzzer._viewer.url)
    try:
        for path, status in (("/", 200), (f"/{'a' * 7000}", 414), ("/../../../etc/passwd", 404)):
            connection = http.client.HTTPConnection(str(place.hostname), place.port, timeout=30)
            connection.request("GET", path)
            assert connection.getresponse().status == status, path
            connection.close()
    finally:
        fuzzer.close()


def test_pictures_have_heights_of_the_list(fuzzer: MessagesFuzzer) -> None:
    """A message may set any value: a height of 9,000 pixels would take gigabytes."""
    page = fuzzer._viewer._page
    try:
        assert page is not None
        for value, height in (("128", 128), ("9000", 128), ("", 128), ("512", 512)):
            page.renderer._height.value = value
            assert page.renderer._pixels() == height
    finally:
        fuzzer.close()
