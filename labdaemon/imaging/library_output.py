"""What LibRaw, libtiff, libpng and OpenCV print on file descriptor 2: caught, so that a caller can judge by it.

These libraries write their warnings in C, past `sys.stderr`, and LibRaw reports some damage in no other way.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterator

# tifffile logs what it finds strange. Without a handler Python prints that on stderr; an application may add its own.
logging.getLogger("tifffile").addHandler(logging.NullHandler())

_LOCK = threading.Lock()
_LIBRARY = re.compile(
    r"data corrupted at|[Uu]nexpected end of file|unknown file|\[ ?(WARN|ERROR|INFO|FATAL):|libpng|TIFF|JPEG|LibRaw|"
    r"OpenCV"
)
"""Lines that come from the libraries; in a process of several threads all others are passed on."""


class LibraryOutput:
    """Text that was printed while `captured_stderr` was active.

    Attributes
    ----------
    text
        The text, complete when the context has ended.
    """

    def __init__(self) -> None:
        self.text: str = ""

    @property
    def reports_damage(self) -> bool:
        """Whether a decoder met data that ends early or cannot be decoded."""
        return bool(re.search(r"corrupt|unexpected end|premature end|TIFF_Error|libpng error|\[ERROR", self.text, re.I))


@contextlib.contextmanager
def captured_stderr() -> Iterator[LibraryOutput]:
    """Catch what is written to file descriptor 2 until the context ends.

    Yields
    ------
    LibraryOutput
        Holds the text afterwards, also when the context is left by an exception. Lines of other threads that no
        library wrote are written to the real descriptor then.
    """
    output = LibraryOutput()
    with _LOCK:
        try:
            real = os.dup(2)
        except OSError:  # a service may run without descriptor 2: then there is nothing to catch
            yield output
            return
        with tempfile.TemporaryFile() as caught:
            try:
                _flush()
                os.dup2(caught.fileno(), 2)
                yield output
            finally:
                _flush()
                os.dup2(real, 2)
                os.close(real)
                caught.seek(0)
                output.text = caught.read().decode(errors="replace")
                _pass_on(output.text)


def _flush() -> None:
    # A closed or replaced sys.stderr has nothing to flush.
    with contextlib.suppress(AttributeError, OSError, ValueError):
        sys.stderr.flush()


def _pass_on(text: str) -> None:
    """Write on what other threads of this process printed meanwhile."""
    if threading.active_count() == 1:
        return
    others = [line for line in text.splitlines(keepends=True) if line.strip() and not _LIBRARY.search(line)]
    if others:
        with contextlib.suppress(OSError):  # descriptor 2 may lead to a pipe whose reader left
            os.write(2, "".join(others).encode())
