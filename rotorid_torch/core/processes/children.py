"""Processes that end with this one, however it ends."""

import os
import signal
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

_WATCHED = """
exec 3<&0 4>&2 </dev/null 2>/dev/null
{ read -r _ <&3; kill -KILL 0; } >/dev/null 4>&- &
watcher=$!
"$@" 2>&4 3<&- 4>&- &
wait $!
ended=$?
kill -KILL $watcher
exit $ended
"""
"""Runs a command beside a watcher that ends the group of both when fd 3, a pipe that nobody writes to, ends."""


@contextmanager
def child(command: Sequence[str], **options: Any) -> Iterator[subprocess.Popen[str]]:
    """Give a running command; it and all that it has started are killed when the block ends, or with this process.

    command : program and arguments. options : of `subprocess.Popen`, but for stdin, which is empty.
    """
    read, write = os.pipe()
    watched = ["/bin/sh", "-c", _WATCHED, "sh", *command]
    try:
        with subprocess.Popen(watched, stdin=read, text=True, start_new_session=True, **options) as running:
            try:
                yield running
            finally:
                if running.poll() is None:
                    with suppress(ProcessLookupError):
                        os.killpg(running.pid, signal.SIGKILL)
    finally:
        os.close(read)
        os.close(write)
