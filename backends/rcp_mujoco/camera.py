"""Off-screen cameras: a separate thread that renders copies of the state."""

from __future__ import annotations

import queue
import struct
import threading
import zlib
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

from rcp_kernel.clock import iso
from rcp_mujoco.bindings import mujoco
from rcp_profiles.messages import Image

__all__ = ["CameraThread", "Frame"]

_AFTER = 1.5  # s: loading OpenGL at once would slow down the start
_JOIN = 5.0  # s


class Frame(NamedTuple):
    """A requested image."""

    camera: str
    qpos: Any
    mocap: tuple[Any, Any]
    stamp: int
    done: Callable[[Image], None]


class CameraThread:
    """Renders with OpenGL, whose context belongs to one thread.

    In this thread, `ready()` is called if rendering works, otherwise `absent(reason)`.
    """

    def __init__(
        self,
        model: Any,
        size: tuple[int, int],
        *,
        ready: Callable[[], None],
        absent: Callable[[str], None],
    ) -> None:
        self._model = model
        self._width, self._height = size
        self._ready, self._absent = ready, absent
        self._frames: queue.Queue[Frame | None] = queue.Queue(maxsize=2)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="mujoco-camera", daemon=True)

    def start(self) -> None:
        """Start the thread, which checks for OpenGL and then renders."""
        self._thread.start()

    def draw(self, frame: Frame) -> bool:
        """Queue an image; return False if the queue is full."""
        try:
            self._frames.put_nowait(frame)
        except queue.Full:
            return False
        return True

    def close(self) -> None:
        """End the thread. Blocks for up to 5 s."""
        self._closing.set()
        while True:
            try:
                self._frames.put_nowait(None)
                break
            except queue.Full:
                with suppress(queue.Empty):  # the thread may have taken them
                    self._frames.get_nowait()
        self._thread.join(_JOIN)

    def _run(self) -> None:
        if self._closing.wait(_AFTER):
            return
        try:
            renderer: Any = mujoco.Renderer(self._model, self._height, self._width)
        except Exception as error:
            text = str(error).splitlines()[0] if str(error) else type(error).__name__
            self._absent(f"there are no cameras, because OpenGL does not work here: {text}")
            return
        try:
            self._ready()
            self._draw_all(renderer)
        finally:
            renderer.close()

    def _draw_all(self, renderer: Any) -> None:
        data = mujoco.MjData(self._model)
        while (frame := self._frames.get()) is not None:
            data.qpos[:] = frame.qpos
            data.mocap_pos[:], data.mocap_quat[:] = frame.mocap
            mujoco.mj_kinematics(self._model, data)
            mujoco.mj_comPos(self._model, data)
            mujoco.mj_camlight(self._model, data)
            renderer.update_scene(data, frame.camera)
            pixels = renderer.render()
            frame.done(
                Image(
                    self._width,
                    self._height,
                    _png(pixels),
                    "png",
                    frame.camera,
                    iso(frame.stamp),
                )
            )


def _png(pixels: Any) -> bytes:
    height, width, _ = pixels.shape
    rows = b"".join(b"\x00" + row.tobytes() for row in pixels)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"".join(
        (
            b"\x89PNG\r\n\x1a\n",
            _chunk(b"IHDR", header),
            _chunk(b"IDAT", zlib.compress(rows, 1)),
            _chunk(b"IEND", b""),
        )
    )


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
