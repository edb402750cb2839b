"""Messages between this process and its workers: a line of JSON, then bytes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import IO, Any

SIZE = "size"


def send(stream: IO[bytes], header: Mapping[str, Any], content: bytes = b"") -> None:
    """Send a message."""
    stream.write(json.dumps({**header, SIZE: len(content)}).encode() + b"\n")
    stream.write(content)
    stream.flush()


def receive(stream: IO[bytes]) -> tuple[dict[str, Any], bytes] | None:
    """Return header and content of the next message, or None where the stream ends."""
    line = stream.readline()
    if not line.endswith(b"\n"):
        return None
    header: dict[str, Any] = json.loads(line)
    content = stream.read(header[SIZE])
    return (header, content) if len(content) == header[SIZE] else None
