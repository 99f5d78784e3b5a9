"""The viewer from a program's side: it never waits for a browser, and refuses what does not fit."""

from __future__ import annotations

import socket
import sys
import threading
import time
import types
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import rich
import torch

import neural_renderer as nr
from neural_renderer.apps.common.observer import Knob, goes_on
from neural_renderer.apps.view.panels.run import problem_of
from neural_renderer.apps.view.records.replay import Record
from neural_renderer.apps.view.server import is_own_page
from neural_renderer.apps.view.viewer import Viewer
from neural_renderer.apps.view.worker import Worker
from tests.apps.view.browser import wait_until
from tests.programs import run_python

MESH = nr.Mesh.icosphere(1)
PATIENCE = 60.0  # seconds


class TestWorker:
    def test_only_the_newest_job_of_a_name_is_done(self) -> None:
        worker, begun, go, done = Worker(1000.0), threading.Event(), threading.Event(), []
        worker.post("first", lambda: (begun.set(), go.wait(PATIENCE))[0])
        assert begun.wait(PATIENCE)
        worker.post("same", lambda: done.append("old"))
        worker.post("other", lambda: done.append("other"))
        for number in range(100):
            worker.post("same", lambda number=number: done.append(number))
        go.set()
        assert worker.wait(PATIENCE) and done == ["other", 99]  # in the order in which they were posted
        worker.close()

    def test_it_rests(self) -> None:
        """Two rounds are 1 / rate apart, or further if they take more than their share."""
        for rate, share in ((10.0, 1.0), (1000.0, 0.1)):
            worker, times, finished = Worker(rate, share), [], threading.Event()

            def job(worker: Worker = worker, times: list[float] = times, finished: threading.Event = finished) -> None:
                times.append(time.monotonic())
                start = time.thread_time()
                while time.thread_time() < start + 0.01:
                    pass
                (worker.post if len(times) < 3 else lambda *_: finished.set())("again", job)

            worker.post("again", job)
            assert finished.wait(PATIENCE)
            # 0.01 seconds in a share of 0.1 are 0.1 seconds, too.
            assert all(late - early >= 0.099 for early, late in pairwise(times))
            worker.close()

    def test_who_waits_ends_a_rest(self) -> None:
        worker, done = Worker(rate=1e-3), []  # a round in 1000 s
        for number in range(3):
            worker.post("job", lambda number=number: done.append(number))
            assert worker.wait(60.0)
        worker.close()
        assert done == [0, 1, 2]

    def test_more_share_ends_a_rest(self) -> None:
        worker, start = Worker(1000.0, 1e-6), time.monotonic()
        worker.post("long", lambda: sum(range(300_000)) and None)
        assert worker.wait(PATIENCE)
        done = threading.Event()
        worker.post("next", done.set)
        worker.set_share(1.0)
        assert done.wait(PATIENCE) and time.monotonic() - start < PATIENCE
        worker.close()

    def test_errors_are_told_once_and_end_nothing(self) -> None:
        worker, done = Worker(1000.0), threading.Event()

        def fail() -> None:
            raise RuntimeError("no such colour")

        with pytest.warns(UserWarning, match=r"RuntimeError: no such colour\); the work goes on") as found:
            worker.post("a", fail)
            worker.wait(PATIENCE)
            worker.post("b", fail)
            worker.post("c", done.set)
            assert done.wait(PATIENCE)
        assert len(found) == 1
        worker.close()
        worker.post("after", fail)  # ignored
        worker.close()


def test_arguments_are_checked(tmp_path: Path) -> None:
    for options, sentence in (
        ({"port": 70_000}, "port: expected at most 65535"),
        ({"port": -1}, "port"),
        ({"rate": 0.0}, "rate"),
        ({"record_limit": 0.5}, "record_limit: expected at least 1 MiB"),
        ({"record": tmp_path / "run.png"}, "record: expected a name"),
    ):
        with pytest.raises(ValueError, match=sentence):
            nr.view(browser=False, **options)
    with pytest.raises(TypeError, match="host: expected a name"):
        nr.view(browser=False, host=3)
    with nr.view(browser=False) as viewer:
        with pytest.raises(ValueError, match="name: expected some text"):
            viewer.show(MESH, "")
        with pytest.raises(TypeError, match="mesh: expected a Mesh"):
            viewer.show("bunny.obj")
        with pytest.raises(ValueError, match="name: expected one of none, got 'bunny'"):
            viewer.remove("bunny")
        with pytest.raises(TypeError, match="loss: expected a number, got str"):
            viewer.log(1, loss="high")
        with pytest.raises(ValueError, match="rate: expected a value from"):
            viewer.knob("rate", 3.0, most=1.0)
        with pytest.raises(ValueError, match="axis: expected one of"):
            viewer.set_up("up")
        with pytest.raises(ValueError, match=r"axis: expected a direction \(x, y, z\), got \(0, 0, 0\)"):
            viewer.set_up((0, 0, 0))
        with pytest.raises(FileNotFoundError, match=r"none\.png"):
            viewer.show_pictures({"none": tmp_path / "none.png"})
        with pytest.raises(ValueError, match="labels: expected at least one step"):
            viewer.show_steps([], print)
    with pytest.raises(RuntimeError, match="viewer: expected an open viewer"):
        viewer.show(MESH)
    assert viewer.close() is None  # again


def test_bad_meshes_are_refused_at_once_however_soon_they_come(tmp_path: Path) -> None:
    """Faces that do not fit the vertices are found in a copy that may come later: it warns, and the record is kept."""
    vertices, faces = nr.cube()
    with nr.view(browser=False, record=tmp_path / "run.html", rate=1e-3) as viewer:
        viewer.show((vertices, faces))
        for bad in ((vertices[:, :2], faces), (vertices, faces[:, :2]), (vertices, faces, vertices)):
            with pytest.raises(ValueError, match="expected"):
                viewer.show(bad)
        viewer.show((vertices, faces), "other")
        viewer.show((vertices[:4], faces), "other")
        with pytest.warns(UserWarning, match="leaves out other: faces: expected vertex indices from 0 to 3"):
            viewer.flush()
    record = Record(tmp_path / "run.html")
    assert list(record.meshes(len(record) - 1)) == ["mesh", "other"]


def test_a_loop_is_recorded(tmp_path: Path) -> None:
    """However fast it is, the first and the last mesh are there, and nothing is shown twice."""
    with nr.view(browser=False, record=tmp_path / "run.html", rate=1000.0) as viewer:
        vertices = MESH.vertices.detach().clone()
        for step in range(200):
            vertices *= 1.01
            viewer.show((vertices, MESH.faces), "sphere")
            viewer.log(step, loss=1 / (step + 1))
    record = Record(tmp_path / "run.html")
    assert 1 <= len(record) <= 200 and len(set(record.labels)) == len(record)
    last = record.meshes(len(record) - 1)["sphere"].vertices
    assert (last - vertices).abs().max() <= float(vertices.abs().max()) / 2**16 * 1.01
    assert len(record.numbers["loss"]) == 200


def test_several_threads(tmp_path: Path) -> None:
    with nr.view(browser=False, record=tmp_path / "run.html", rate=1000.0) as viewer:

        def work(name: str) -> None:
            for step in range(50):
                viewer.show(MESH, name)
                viewer.log(step, **{name: 1.0})

        threads = [threading.Thread(target=work, args=(f"mesh {number}",)) for number in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    record = Record(tmp_path / "run.html")
    assert sorted(record.meshes(len(record) - 1)) == [f"mesh {number}" for number in range(4)]
    assert all(len(points) == 50 for points in record.numbers.values())


def test_copies_take_a_small_share(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mesh whose copy takes 10 ms is copied again a second later at the earliest."""
    from neural_renderer.apps.view import newest as module

    now, copies = [0.0], []

    def slow_copy(mesh: Any) -> Any:
        copies.append(now[0])
        now[0] += 0.01
        return copy(mesh)

    copy = module.take_snapshot
    monkeypatch.setattr(module, "take_snapshot", slow_copy)
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(module.time, "perf_counter", lambda: now[0])
    viewer = Viewer(browser=False, record=None)
    viewer._newest._is_watched = lambda: True
    for step in range(1, 1001):
        viewer.observe("fit", step, 2000, {"loss": 1.0}, lambda: MESH)
        now[0] += 0.01
    assert 9 <= len(copies) <= 11  # in ten seconds
    assert min(late - early for early, late in pairwise(copies)) >= 1.0
    viewer.close()


def test_nobody_looks_costs_nothing() -> None:
    """Without a browser and a record, the mesh is made about once a second."""
    viewer, made = Viewer(browser=False), []
    start = time.monotonic()
    for step in range(1, 10_001):
        viewer.observe("fit", step, 20_000, {"loss": 1.0}, lambda: made.append(0) or MESH)
    assert len(made) <= 2 + (time.monotonic() - start)
    viewer.close()


def test_pause_stop_and_settings() -> None:
    viewer = Viewer(browser=False)
    assert viewer.proceed() and not viewer.paused and not viewer.stopped
    rate = viewer.knob("rate", 0.1, most=1.0)
    viewer.offer([Knob("rate", 0.1), Knob("background", "grey", choices=("grey", "white"))])
    viewer._run.change("rate", 0.5)
    viewer._run.change("background", "white")
    assert rate() == 0.5 and viewer.changes() == {"rate": 0.5, "background": "white"} and viewer.changes() == {}
    viewer._run.paused = True
    released = threading.Event()

    def go_on() -> None:
        released.set()
        viewer._run.paused = False

    threading.Timer(0.2, go_on).start()
    assert viewer.proceed() and released.is_set()  # it waited for the end of the pause, however long that took
    viewer._run.paused = True
    assert goes_on(viewer, interrupted=[2])  # Ctrl-C ends a pause
    viewer._run.stopped = True
    assert not viewer.proceed()
    viewer.close()


def test_a_further_setting_keeps_the_others() -> None:
    with Viewer(browser=False) as viewer:
        rate = viewer.knob("rate", 0.1, most=1.0)
        viewer._run.change("rate", 0.5)
        weight = viewer.knob("weight", 3.0)
        assert viewer.knob("rate", 0.1, most=1.0)() == rate() == 0.5 and weight() == 3.0
        # The fields show what holds.
        assert {name: knob.value for name, knob in viewer._run.knobs.items()} == {"rate": 0.5, "weight": 3.0}


@pytest.mark.parametrize("text", ["1e-4", "0", " 0.0025 ", "1"])
def test_numbers_of_settings(text: str) -> None:
    assert problem_of(Knob("rate", 100.0, 0.0, 1.0), text) is None


@pytest.mark.parametrize("text", ["", "1e", "-3", "2", "nan", "inf", "0,5"])
def test_what_is_no_number_of_a_setting(text: str) -> None:
    problem = problem_of(Knob("vertex_rate", 0.5, 0.0, 1.0), text)
    assert problem == f"vertex rate: expected a number from 0 to 1, got {text!r}"


def test_axes_of_curves_grow_in_steps() -> None:
    from neural_renderer.apps.view.panels.run import round_up

    assert [round_up(value) for value in (0.0, 1.0, 10.0, 11.0, 21.0, 100.0, 501.0)] == [10, 10, 10, 20, 50, 100, 1000]


class TestServer:
    def test_a_port_in_use_moves_to_the_next(self, open_viewer: Callable[..., Viewer]) -> None:
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            taken.listen()
            port = taken.getsockname()[1]
            with pytest.warns(UserWarning, match=rf"port {port} is in use; the viewer takes (\d+)"):
                viewer = open_viewer(port=port)
        assert viewer.url != f"http://127.0.0.1:{port}"
        assert int(viewer.url.rpartition(":")[2]) > port

    def test_only_this_machine_is_listened_to(self, open_viewer: Callable[..., Viewer]) -> None:
        port = int(open_viewer().url.rpartition(":")[2])
        with socket.socket() as probe:
            probe.settimeout(1.0)
            assert probe.connect_ex(("127.0.0.2", port)) != 0  # another address of this machine

    def test_other_hosts_are_explained(self, open_viewer: Callable[..., Viewer]) -> None:
        with pytest.warns(UserWarning, match=r"anyone who reaches port .* no password and no encryption"):
            assert open_viewer(host="0.0.0.0").url.startswith("http://127.0.0.1:")
        with pytest.raises(OSError, match=r"host: expected a name or an address of this machine, got 'no\.such"):
            open_viewer(host="no.such.host.invalid")
        with pytest.raises(OSError, match=r"host: expected an address of this machine, got '192\.0\.2\.1'"):
            open_viewer(host="192.0.2.1")

    def test_pages_of_other_servers_are_refused(self, open_viewer: Callable[..., Viewer]) -> None:
        """The page itself, a tunnel's other port and programs without a page connect; other pages do not."""
        viser = pytest.importorskip("viser")
        from websockets.exceptions import InvalidStatus
        from websockets.sync.client import connect
        from websockets.typing import Subprotocol

        viewer = open_viewer()
        address = viewer.url.replace("http", "ws")
        protocols = [Subprotocol(f"viser-v{viser.__version__}")]

        def join(origin: Any) -> None:
            with connect(address, origin=origin, subprotocols=protocols, max_size=None) as one:
                assert one.recv(timeout=60)  # the scene

        for origin in (viewer.url, None):
            join(origin)
        for origin in ("http://example.org", "null", viewer.url.replace("127.0.0.1", "localhost"), viewer.url + "1"):
            with pytest.raises(InvalidStatus, match="403"):
                join(origin)
        wait_until(lambda: viewer.clients == 0, "the end of the connections")

    @pytest.mark.parametrize(
        ("origin", "host", "is_local", "is_own"),
        [
            ("http://127.0.0.1:9000", "127.0.0.1:9000", True, True),
            ("http://localhost:8080", "localhost:8080", True, True),
            ("http://[::1]:8080", "[::1]:8080", True, True),
            ("https://lab.example.org", "lab.example.org", False, True),
            ("http://evil.example.org:8080", "evil.example.org:8080", True, False),  # a name that points to 127.0.0.1
            ("http://evil.example.org", "lab.example.org:8080", False, False),
            ("http://127.0.0.1:9000", "127.0.0.1:8080", True, False),
            ("file://", "", True, False),
            ("http://[::1", "[::1", True, False),
        ],
    )
    def test_what_its_own_page_is(self, origin: str, host: str, is_local: bool, is_own: bool) -> None:
        assert is_own_page(origin, host, is_local) == is_own

    def test_nothing_is_printed_but_the_address(self, capfd: pytest.CaptureFixture[str]) -> None:
        pytest.importorskip("viser")
        with nr.view(port=0) as viewer:
            url = viewer.url
        out, err = capfd.readouterr()
        assert out == f"viewer: {url}\n" and err == ""

    def test_requests_of_other_kinds_are_no_news(
        self, open_viewer: Callable[..., Viewer], capfd: pytest.CaptureFixture[str]
    ) -> None:
        """``curl -I`` asks for the head of the page; a port scanner sends anything."""
        host, _, port = open_viewer().url.removeprefix("http://").partition(":")
        for request in (b"HEAD / HTTP/1.1\r\nHost: here\r\n\r\n", b"\x16\x03nonsense\r\n\r\n"):
            with socket.create_connection((host, int(port)), timeout=10) as connection:
                connection.sendall(request)
                connection.recv(100)  # the server has dealt with it
        assert capfd.readouterr().err == ""

    def test_no_public_address_can_be_asked_for(self, open_viewer: Callable[..., Viewer]) -> None:
        assert open_viewer()._page.server.request_share_url() is None

    def test_a_closed_viewer_frees_its_port(self, open_viewer: Callable[..., Viewer]) -> None:
        viewer = open_viewer()
        port = int(viewer.url.rpartition(":")[2])
        viewer.close()
        assert open_viewer(port=port).url.endswith(f":{port}")

    def test_viser_is_named_where_it_is_missing(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "viser", None)
        before = threading.active_count()
        with pytest.raises(ModuleNotFoundError, match=r'pip install "neural-renderer\[view\]"'):
            nr.view()
        assert threading.active_count() <= before


@pytest.mark.slow
def test_a_program_that_forgets_to_close_ends(tmp_path: Path) -> None:
    pytest.importorskip("viser")
    program = tmp_path / "program.py"
    program.write_text(
        "import neural_renderer as nr\nviewer = nr.view(port=0)\nviewer.show(nr.Mesh.icosphere(1))\nprint('end')\n"
    )
    done = run_python(program)
    assert done.returncode == 0 and done.stdout.endswith("end\n") and not done.stderr, done.stderr


def test_in_a_notebook_the_page_is_inline(
    open_viewer: Callable[..., Viewer], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The page alone: viser's table, which rich displays there, is not."""
    shown: list[Any] = []
    monkeypatch.setattr(rich.get_console(), "is_jupyter", True)
    monkeypatch.setattr("rich.jupyter.display", lambda *_: shown.append("printed"))
    shell = types.SimpleNamespace(kernel=object())
    ipython = types.ModuleType("IPython")
    ipython.get_ipython = lambda: shell  # type: ignore[attr-defined]
    display = types.ModuleType("IPython.display")
    display.HTML = lambda text: text  # type: ignore[attr-defined]
    display.display = shown.append  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    with nr.view(port=0) as viewer:
        assert f'<iframe src="{viewer.url}"' in shown[0] == viewer._repr_html_()
    assert len(shown) == 1 and not rich.get_console().quiet
    assert capsys.readouterr().out == ""


def test_snapshots_of_a_viewer(tmp_path: Path) -> None:
    with nr.view(browser=False) as viewer:
        viewer.show(MESH, "sphere")
        assert viewer.save_record(tmp_path / "now.html").startswith(f"{tmp_path / 'now.html'}: 1 frame, ")
        viewer.remove("sphere")
    assert torch.equal(Record(tmp_path / "now.html").meshes(0)["sphere"].faces, MESH.faces)
