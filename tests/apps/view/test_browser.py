"""The page and the records in a real browser: what is to be seen, and what the controls do."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.view.viewer import Viewer
from tests.apps.view.browser import Browser, wait_until
from tests.paths import EXAMPLES, ROOT

_DISABLED = """[...document.querySelectorAll("button")].some((one) =>
    one.innerText === "Whole view" && getComputedStyle(one).pointerEvents === "none")"""
RED = (1.0, 0.0, 0.0)


def sphere(color: tuple[float, float, float], radius: float = 1.0) -> nr.Mesh:
    vertices, faces = nr.icosphere(3, radius)
    return nr.Mesh(vertices, faces, face_colors=torch.tensor(color).expand(len(faces), 3), texture_size=1)


def reddish(pixels: np.ndarray) -> np.ndarray:
    """Pixels of a red mesh in any light; the panel has none."""
    r, g, b = (pixels[..., channel].astype(int) for channel in range(3))
    return (r > 60) & (g < 0.5 * r) & (b < 0.5 * r) & (np.arange(pixels.shape[1]) < 0.6 * pixels.shape[1])


def wait_for_pixels(browser: Browser, test: Callable[[np.ndarray], bool], what: str) -> np.ndarray:
    return wait_until(lambda: pixels if test(pixels := browser.screenshot()) else None, what)


def test_a_mesh_is_to_be_seen_and_turns(browser: Browser, open_viewer: Callable[..., Viewer]) -> None:
    """The browser shows what our own renderer draws from the same view."""
    viewer = open_viewer()
    viewer.show(sphere(RED), "ball")
    browser.open(viewer.url)
    browser.wait_for_text("642 vertices, 1,280 faces")
    pixels = wait_for_pixels(browser, lambda pixels: reddish(pixels).sum() > 5000, "a red ball")
    [client] = viewer._page.server.get_clients().values()
    # The browser's own picture, without panels.
    seen = reddish_anywhere(client.get_render(120, 160, timeout=60.0)[..., :3])
    from neural_renderer.apps.view.drawing.our_picture import View, picture

    camera = client.camera
    view = View(camera.wxyz, camera.position, camera.fov, 160 / 120)
    shown = viewer._page.scene.meshes["ball"]
    ours = picture([(shown.snapshot, shown.place)], view, 120, output="alpha")[..., 0] > 127
    assert (seen & ours).sum() / (seen | ours).sum() > 0.97  # the rest are pixels at the outline
    # A ball beside the middle moves when the view turns.
    viewer.show(sphere((0.0, 0.0, 1.0)), "other")
    pixels = wait_for_pixels(
        browser,
        lambda pixels: reddish(pixels).sum() > 1000 and bool(np.argwhere(reddish(pixels)).mean(0)[1] < 280),
        "two balls side by side",
    )
    pixels = wait_until_still(browser, pixels)
    before = np.argwhere(reddish(pixels)).mean(0)
    browser.drag((300, 400), (440, 400))
    wait_for_pixels(
        browser,
        lambda pixels: bool(np.linalg.norm(np.argwhere(reddish(pixels)).mean(0) - before) > 15),
        "a ball that has moved",
    )
    assert not browser.errors, browser.errors
    # Nothing is fetched from elsewhere.
    assert all(url.startswith((viewer.url, "data:", "blob:")) for url in browser.requests), browser.requests


def reddish_anywhere(pixels: np.ndarray) -> np.ndarray:
    r, g, b = (pixels[..., channel].astype(int) for channel in range(3))
    return (r > 60) & (g < 0.5 * r) & (b < 0.5 * r)


@pytest.mark.slow
def test_images_and_controls(browser: Browser, open_viewer: Callable[..., Viewer], tmp_path: Path) -> None:
    viewer = open_viewer()
    spot = nr.UVMesh.load(EXAMPLES / "data" / "spot.obj")
    viewer.show(spot, "spot")
    browser.open(viewer.url)
    browser.wait_for_text("2,930 vertices")

    def scene(pixels: np.ndarray) -> np.ndarray:
        return pixels[200:, 40 : int(0.6 * pixels.shape[1])].astype(int)

    def dark(pixels: np.ndarray) -> int:
        return int((scene(pixels).max(2) < 70).sum())  # the cow's black spots

    seen = wait_for_pixels(browser, lambda pixels: dark(pixels) > 500, "black spots of the texture")
    for control in ("Smooth", "Light", "Normals", "Wireframe"):
        before = scene(wait_until_still(browser, seen))
        browser.click(control)
        seen = wait_for_pixels(
            browser,
            lambda pixels, before=before: (np.abs(scene(pixels) - before).max(2) > 3).sum() > 100,
            f"a picture that {control} changes",
        )
    # Our own renderer's picture appears, and so do arrows of a gradient.
    browser.click("Picture")
    browser.wait_for_text("Our renderer")
    wait_until(lambda: viewer._page.renderer._image.image.shape[0] == 256, "our own picture")
    browser.click("Gradient")
    browser.wait_for_text("largest gradient")
    wait_until(lambda: viewer._page.renderer._arrows, "arrows")
    browser.click("Gradient")
    wait_until(lambda: viewer._page.renderer._arrows is None, "no arrows")
    assert not browser.errors, browser.errors


def wait_until_still(browser: Browser, seen: np.ndarray) -> np.ndarray:
    """Return the screenshot after which nothing has changed for a moment; ``seen`` is the last one that was taken."""
    end = time.monotonic() + 90
    while True:
        time.sleep(0.2)
        now = browser.screenshot()
        if np.array_equal(now, seen):
            return now
        assert time.monotonic() < end, "waited for a picture that stands still"
        seen = now


def moves(steps: list[int]) -> bool:
    """Whether a program of 50 steps a second takes one within a moment."""
    before = steps[0]
    time.sleep(0.3)
    return steps[0] != before


def test_pause_settings_and_stop(
    browser: Browser, open_viewer: Callable[..., Viewer], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A loop as a program writes it: pause pauses, a setting changes, stop ends it."""
    monkeypatch.setattr("neural_renderer.apps.view.panels.run.SETTLED", 0.1)
    viewer, steps = open_viewer(), [0]
    rate, weight = viewer.knob("rate", 0.5, most=1.0), viewer.knob("weight", 100.0)

    def work() -> None:
        while viewer.proceed():
            steps[0] += 1
            viewer.show(sphere(RED, 1 + 0.1 * np.sin(steps[0] / 5)), "ball")
            viewer.log(steps[0], loss=1 / steps[0])
            time.sleep(0.02)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        browser.open(viewer.url)
        browser.wait_for_text("loss")
        browser.click("Pause")
        wait_until(lambda: viewer.paused, "a pause")
        browser.wait_for_text("Go on")
        wait_until(lambda: not moves(steps), "a program that stands still")  # after the step that had begun
        paused = steps[0]
        type_into(browser, "rate", "0.25")
        wait_until(lambda: rate() == 0.25, "a rate of 0.25")
        type_into(browser, "weight", "2.5e-4")  # it was 100
        wait_until(lambda: weight() == 2.5e-4, "a weight of 0.00025")
        type_into(browser, "rate", "-3")
        browser.wait_for_text("rate: expected a number from 0 to 1, got '-3'")
        assert rate() == 0.25
        browser.click("Go on")
        wait_until(lambda: steps[0] > paused, "more steps")
        browser.click("Stop and keep")
        thread.join(60)
        assert not thread.is_alive() and viewer.stopped
    finally:
        viewer._run.stopped = True
        thread.join(60)
    assert not browser.errors, browser.errors


def type_into(browser: Browser, label: str, text: str) -> None:
    """Type a number into the field with a label."""
    select = f"""(() => {{
        const name = {json.dumps(label)};
        const label = [...document.querySelectorAll("label")].find((one) => one.innerText.trim() === name);
        let part = label;
        while (part && !part.querySelector("input")) part = part.parentElement;
        if (!part) return false;
        const field = part.querySelector("input");
        field.focus(); field.select();
        return true;
    }})()"""
    wait_until(lambda: browser.evaluate(select), f"the field {label}")
    browser.call("Input.insertText", text=text)
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key="Enter", code="Enter", windowsVirtualKeyCode=13)


def test_a_closed_browser_stops_nothing(browser: Browser, open_viewer: Callable[..., Viewer]) -> None:
    viewer = open_viewer()
    viewer.show(sphere(RED))
    browser.open(viewer.url)
    wait_until(lambda: viewer.clients == 1, "a browser")
    browser.open("about:blank")
    wait_until(lambda: viewer.clients == 0, "no browser")
    for step in range(1, 50):
        viewer.observe("fit", step, 100, {"loss": 1.0}, lambda: sphere(RED))
    viewer.flush()
    browser.open(viewer.url)  # it may come back
    wait_for_pixels(browser, lambda pixels: reddish(pixels).sum() > 2000, "the ball again")


def test_a_page_that_was_open_before_sees_all(browser: Browser, open_viewer: Callable[..., Viewer]) -> None:
    """Its camera follows the meshes that come, until somebody moves it."""
    viewer = open_viewer()
    browser.open(viewer.url)
    wait_until(lambda: viewer.clients == 1, "a browser")
    [client] = viewer._page.server.get_clients().values()
    told = [0.0]  # distances that the browser tells; the server's own number may be ahead of it
    client.camera.on_update(lambda camera: told.append(float(np.linalg.norm(camera.position))))
    for size in (5.0, 20.0):
        viewer.show(sphere(RED, size))
        # All corners of the box around it are in a field of view of 0.7.
        wait_until(lambda size=size: 3 < told[-1] / size < 6, "the whole ball")
    browser.drag((300, 400), (440, 420))
    wait_until(lambda: not viewer._page.scene.first_view.is_unmoved(client), "a camera that has moved")
    viewer.show(sphere(RED, 1.0))
    viewer.flush()
    assert np.linalg.norm(client.camera.position) > 50  # turned, but where it was


@pytest.mark.slow
def test_a_page_outlives_its_killed_program(browser: Browser, tmp_path: Path) -> None:
    """After kill -9 the page says that the connection is lost, and the port is free again."""
    pytest.importorskip("viser")
    program = (
        "import time, neural_renderer as nr\n"
        "viewer = nr.view(port=0)\n"
        "viewer.show(nr.Mesh.icosphere(3))\n"
        "time.sleep(600)\n"
    )
    process = subprocess.Popen([sys.executable, "-u", "-c", program], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        url = process.stdout.readline().removeprefix("viewer: ").strip()
        browser.open(url)
        browser.wait_for_text("642 vertices")
        process.send_signal(signal.SIGKILL)
        process.wait(60)
        # viser's page disables its controls while there is no connection.
        wait_until(lambda: browser.evaluate(_DISABLED), "a page that says so")
        with nr.view(port=int(url.rpartition(":")[2])) as viewer:
            assert viewer.url == url
            viewer.show(nr.Mesh.icosphere(2))
            browser.wait_for_text("162 vertices")  # the page connects again by itself
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


class TestRecord:
    def test_it_opens_from_disk(self, browser: Browser, tmp_path: Path) -> None:
        path = tmp_path / "run.html"
        with nr.view(browser=False, record=path, rate=1000.0) as viewer:
            for step in range(1, 6):
                viewer.log(step, loss=1 / step)
                viewer.show(sphere(RED, 0.2 * step), "ball")
                viewer.flush()
        browser.open(path.as_uri())
        wait_until(lambda: browser.evaluate("document.body && document.body.dataset.frame"), "a frame")
        text = browser.text()
        assert "5 frames" in text and "step 5" in text and "run" in text
        large = int(reddish(browser.screenshot()).sum())
        assert large > 5000
        # The slider goes back to the small ball. The camera stands where the first frame is seen whole.
        browser.evaluate("(() => { const s = document.getElementById('slider'); s.value = 0; s.oninput(); })()")
        wait_until(lambda: browser.evaluate("document.body.dataset.frame") == "0", "the first frame")
        small = wait_for_pixels(browser, lambda pixels: 100 < reddish(pixels).sum() < large / 4, "a smaller ball")
        assert "step 1" in browser.text()
        browser.click("Wireframe")
        wait_for_pixels(browser, lambda pixels: (pixels != small).any(), "a wireframe")
        browser.click("Colours")
        wait_for_pixels(browser, lambda pixels: reddish(pixels).sum() == 0, "clay")
        browser.click("Play")
        wait_until(lambda: browser.evaluate("document.body.dataset.frame") == "4", "the last frame again")
        assert not browser.errors, browser.errors
        assert [url for url in browser.requests if not url.startswith(("data:", "blob:"))] == [path.as_uri()]

    def test_images_are_drawn_as_by_the_renderer(self, browser: Browser, tmp_path: Path) -> None:
        """Red and green halves of an image lie where they belong."""
        vertices, faces = nr.cube()
        image = torch.zeros(64, 64, 3)
        image[:, :32, 0] = image[:, 32:, 1] = 1
        uv = torch.stack((vertices[:, 0] / (vertices[:, 0].max() * 2) + 0.5, vertices[:, 1] * 0 + 0.5), 1)
        with nr.view(browser=False) as viewer:
            viewer.show(nr.UVMesh(vertices, faces, uv, image), "cube")
            viewer.save_record(tmp_path / "cube.html")
        browser.open((tmp_path / "cube.html").as_uri())
        wait_until(lambda: browser.evaluate("document.body && document.body.dataset.frame"), "a frame")
        pixels = browser.screenshot().astype(int)
        red = np.argwhere(reddish(pixels))
        green = np.argwhere((pixels[..., 1] > 60) & (pixels[..., 0] < 0.5 * pixels[..., 1]))
        assert min(len(red), len(green)) > 2000
        # +x is to the right of a camera that stands at +z.
        assert red[:, 1].mean() < green[:, 1].mean()
        assert not browser.errors, browser.errors
