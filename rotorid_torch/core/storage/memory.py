"""A bound on what a piece of work may take, for readers of other libraries that believe a damaged file's sizes."""

import re
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def bounded_memory(more: int) -> Iterator[None]:
    """Let the process take at most so many bytes more until the block ends; beyond them MemoryError is raised.

    The bound is on the address space of the whole process; where the system does not tell its size there is none.
    """
    status = Path("/proc/self/status")
    size = re.search(r"^VmSize:\s+(\d+) kB", status.read_text(), re.MULTILINE) if status.exists() else None
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    bound = int(size[1]) * 1024 + more if size else resource.RLIM_INFINITY
    tighter = bound != resource.RLIM_INFINITY and (soft == resource.RLIM_INFINITY or bound < soft)
    if tighter:
        resource.setrlimit(resource.RLIMIT_AS, (bound, hard))
    try:
        yield
    finally:
        if tighter:
            resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
