"""A limit of memory for libraries that allocate as much as a file declares."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_ONE = threading.RLock()  # the limit is that of the process


@contextmanager
def memory_within(most: int) -> Iterator[None]:
    """Let this process map at most so many bytes more than it has, on Linux: others fail, in all threads."""
    if sys.platform != "linux":
        yield
        return
    import resource

    with _ONE:
        mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        limits = [value for value in (mapped + most, soft, hard) if value != resource.RLIM_INFINITY]
        resource.setrlimit(resource.RLIMIT_AS, (min(limits), hard))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
