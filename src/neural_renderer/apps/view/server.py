"""Start of viser: its import, the port, and security on addresses other than localhost."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import io
import ipaddress
import logging
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from http import HTTPStatus
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import rich

from ...io.files import import_library, warn

if TYPE_CHECKING:
    import viser

_STOPPING = 1.0  # seconds that the end waits for open connections
_PORTS = 100  # most ports that are tried
_LONGEST_PATH = 1024  # characters of the path of a request
_THEME = (43, 90, 140)  # RGB of buttons
_NARROW = 480  # width of a window in pixels below which panels hide its content; docked panels do not count
_STARTING = threading.Lock()
_QUIET = logging.getLogger(f"{__name__}.requests")  # malformed requests are the senders' matter, not the terminal's
_QUIET.addHandler(logging.NullHandler())
_QUIET.propagate = False


def start_server(host: str, port: int, label: str) -> tuple[viser.ViserServer, str]:
    """Start a server for browsers at the first free port from ``port`` on, 0 for any; return also its address.

    ModuleNotFoundError: viser is not installed. OSError: the host is unknown, or no port is free. A warning says that
    the port is another one, or that the page is open to other machines. ``label`` is the title of the page's panel.
    """
    viser = import_library("viser", "for the viewer")
    free = _free_port(host, port)
    thread = threading.get_ident()
    with _without_output(lambda _: threading.get_ident() == thread), _own_pages_only(_is_loopback(host)):  # a table
        server = viser.ViserServer(host=host, port=free, verbose=False)
    # Refuse requests for a public address of this page on the server of a company.
    server.request_share_url = lambda *_, **__: None
    server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=_THEME)
    server.gui.set_panel_label(label)
    server.gui.main_panel.dock_right()
    server.on_client_connect(_make_room)
    found = server.get_port()
    if port and found != port:
        warn(f"port {port} is in use; the viewer takes {found}")
    if not _is_loopback(host):
        warn(
            f"host {host}: anyone who reaches port {found} of this machine can see the meshes and stop the work; there "
            "is no password and no encryption. 127.0.0.1 with `ssh -L` is safer"
        )
    name = {"0.0.0.0": "127.0.0.1", "": "127.0.0.1", "::": "::1"}.get(host, host)
    return server, f"http://{f'[{name}]' if ':' in name else name}:{found}"


def _make_room(client: viser.ClientHandle) -> None:
    """Fold the panels of a narrow window, such as a phone's, which would hide the object."""
    if client.camera.image_width < _NARROW:
        client.gui.main_panel.minimize()


def stop_server(server: viser.ViserServer) -> None:
    """End a server; browsers show that the connection is lost. Its thread may need seconds more to wind down."""

    def stop() -> None:
        with _without_output(lambda text: "viser" in text):  # "Server stopped"
            server.stop()

    thread = threading.Thread(target=stop, name="neural-renderer viewer's end", daemon=True)
    thread.start()
    thread.join(_STOPPING)


class _Filtered(io.TextIOBase):
    """Standard output without some of the texts."""

    def __init__(self, stream: Any, drops: Callable[[str], bool]) -> None:
        self._stream, self._drops = stream, drops

    def write(self, text: str) -> int:
        return len(text) if self._drops(text) else self._stream.write(text)

    def flush(self) -> None:
        self._stream.flush()

    def isatty(self) -> bool:
        return bool(self._stream.isatty())


@contextlib.contextmanager
def _without_output(drops: Callable[[str], bool]) -> Iterator[None]:
    """Filter viser's own messages from the output.

    In a notebook rich's own console, which viser prints with, bypasses the standard output.
    """
    before, console = sys.stdout, rich.get_console()
    filtered = sys.stdout = _Filtered(before, drops)
    was_quiet, console.quiet = console.quiet, console.quiet or console.is_jupyter
    try:
        yield
    finally:
        console.quiet = was_quiet
        if sys.stdout is filtered:  # nobody else has replaced it meanwhile
            sys.stdout = before


@contextlib.contextmanager
def _own_pages_only(is_local: bool) -> Iterator[None]:
    """Make viser's server refuse connections from pages of other servers.

    A browser lets every page open a websocket to this machine, and names the page's server in the header "Origin".
    viser does not look at it and has no option for it, so its call of websockets is extended.
    """
    import websockets.asyncio.server as module

    with _STARTING:
        serve = module.serve

        def checked(handler: Any, *args: Any, process_request: Any = None, **options: Any) -> Any:
            def process(connection: Any, request: Any) -> Any:
                if not is_own_page(request.headers.get("Origin"), request.headers.get("Host", ""), is_local):
                    return connection.respond(HTTPStatus.FORBIDDEN, "pages of other servers may not connect\n")
                if len(request.path) > _LONGEST_PATH:
                    return connection.respond(HTTPStatus.REQUEST_URI_TOO_LONG, "the address is too long\n")
                return None if process_request is None else process_request(connection, request)

            async def quiet(connection: Any) -> None:
                try:
                    await handler(connection)
                except Exception:  # a message that is none of viser's ends its own connection only
                    _QUIET.debug("a connection ended", exc_info=True)

            if not str(handler.__module__).startswith("viser."):  # another thread may start another server
                return serve(handler, *args, process_request=process_request, **options)
            asyncio.get_running_loop().set_exception_handler(_note)
            return serve(quiet, *args, process_request=process, **{"logger": _QUIET, **options})

        module.serve = checked  # type: ignore[assignment,misc]
        try:
            yield
        finally:
            module.serve = serve  # type: ignore[misc]


def _note(_: Any, context: dict[str, Any]) -> None:
    """Note an error of a task of the server's loop, which answers messages of browsers."""
    _QUIET.debug("%s", context.get("message"), exc_info=context.get("exception"))


def is_own_page(origin: str | None, host: str, is_local: bool) -> bool:
    """Return whether a request comes from this server's page, or from no page, by its headers "Origin" and "Host".

    If only this machine reaches the server (``is_local``), names of other machines are refused: whoever owns a name can
    let it point to 127.0.0.1.
    """
    if origin is None:
        return True
    try:
        asking, asked = urlsplit(origin), urlsplit(f"//{host}")
        name = asked.hostname or ""
    except ValueError:
        return False
    is_own_name = name == "localhost" or _address(name) is not None
    return asking.netloc == asked.netloc != "" and (not is_local or is_own_name)


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """Return a host given as an IP address; None for a name."""
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


def _free_port(host: str, port: int) -> int:
    try:
        family, _, _, _, _ = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM)[0]
    except socket.gaierror as error:
        raise OSError(f"host: expected a name or an address of this machine, got {host!r} ({error.strerror})") from None
    for candidate in range(port, min(port + _PORTS, 65536)) if port else (0,):
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # ports of closed servers, as viser
            try:
                probe.bind((host, candidate))
            except PermissionError as error:
                raise OSError(f"port: expected one that this user may open, got {candidate}") from error
            except OSError as error:
                if error.errno == errno.EADDRNOTAVAIL:
                    raise OSError(f"host: expected an address of this machine, got {host!r}") from None
                continue
            return int(probe.getsockname()[1])
    raise OSError(f"port: expected a free one from {port} to {port + _PORTS - 1}, got none")


def _is_loopback(host: str) -> bool:
    """Return whether only this machine reaches a host."""
    address = _address(host)
    return host == "localhost" if address is None else address.is_loopback
