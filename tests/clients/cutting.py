"""A proxy that loses answers of a gateway: the request has arrived, and the client hears nothing."""

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from types import TracebackType
from typing import Self
from urllib.parse import urlsplit

__all__ = ["CuttingProxy"]

_BLOCK = 1 << 16  # bytes


class CuttingProxy:
    """Passes connections on while entered; the answer of every second one is lost, but of none that writes."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self._target = parts.hostname or "", parts.port or 80
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self.cuts = 0
        self._loses = False
        self._thread = threading.Thread(target=self._accept, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                threading.Thread(target=self._pass, args=(client,), daemon=True).start()

    def _pass(self, client: socket.socket) -> None:
        with client, suppress(OSError), socket.create_connection(self._target) as gateway:
            request = client.recv(_BLOCK)
            gateway.sendall(request)
            threading.Thread(target=self._copy, args=(client, gateway), daemon=True).start()
            if not request.startswith(b"PUT "):
                self._loses = not self._loses
            loses = self._loses and not request.startswith(b"PUT ")
            while data := gateway.recv(_BLOCK):
                if loses:
                    self.cuts += 1
                    break
                client.sendall(data)
            client.shutdown(socket.SHUT_RDWR)  # `_copy` reads from it: closing would not end it

    def _copy(self, source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(_BLOCK):
                target.sendall(data)
