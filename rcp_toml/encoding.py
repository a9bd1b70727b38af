"""The text of a configuration file, whatever editor wrote it."""

from __future__ import annotations

import codecs

from rcp_protocol.errors import ConfigError

__all__ = ["NotUtf8", "decoded"]

_BOM = "\ufeff"


class NotUtf8(ConfigError):
    """A file in another encoding; `line` is the first that is not UTF-8."""

    def __init__(self, message: str, line: int = 1) -> None:
        super().__init__(message)
        self.line = line


def decoded(data: bytes) -> str:
    """Return the text of a file, without the mark that some editors of Windows begin it with.

    :raises NotUtf8: it is in another encoding.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise NotUtf8("the file is UTF-16: save it as UTF-8")
    try:
        return data.decode().removeprefix(_BOM)
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        text = f"line {line} is not UTF-8 (byte 0x{data[error.start]:02x}): save the file as UTF-8"
        raise NotUtf8(text, line) from None
