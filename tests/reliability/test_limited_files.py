"""Reading within a limit. Evidence: property, with files that state no size."""

from __future__ import annotations

import os
from pathlib import Path
from threading import Thread

import pytest

from calib.core.limited import TooLargeError, read_limited


def test_a_file_is_read_whole_up_to_the_limit(tmp_path: Path) -> None:
    file = tmp_path / "f"
    file.write_bytes(b"x" * 1000)
    assert read_limited(file, 1000) == b"x" * 1000
    with pytest.raises(TooLargeError):
        read_limited(file, 999)


def test_what_states_no_size_is_read_to_its_end_or_the_limit(tmp_path: Path) -> None:
    pipe, content = tmp_path / "pipe", b"0123456789" * 20_000
    os.mkfifo(pipe)
    writer = Thread(target=pipe.write_bytes, args=(content,))
    writer.start()
    assert read_limited(pipe, len(content)) == content
    writer.join()
    with pytest.raises(TooLargeError):
        read_limited(Path("/dev/zero"), 1000)
    with pytest.raises(OSError, match="no plain file"):
        read_limited(pipe, 1000, regular=True)
