"""Runs beside each other in a browser: served on loopback, and nothing but the pages."""

from __future__ import annotations

import threading
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from rotorid_torch.commands.show import comparison, server_of
from rotorid_torch.report.records import read_report
from tests.test_cli import a_run


def test_runs_are_compared_and_their_reports_served_and_nothing_else(tmp_path: Path):
    runs = [a_run(tmp_path / name) for name in ("one", "two")]
    for run in runs:
        (run / "report.html").write_text(f"<p>{run.name}</p>")
    page = comparison({str(run): read_report(run) for run in runs})
    assert "one</a>" in page
    with server_of(page, runs) as server:
        assert server.server_address[0] == "127.0.0.1"
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_address[1]}"

        def read(path: str) -> str:
            with urllib.request.urlopen(address + path) as answer:
                return answer.read().decode()

        assert "2 runs" in read("/")
        assert [read(f"/{k}/") for k in (0, 1)] == ["<p>one</p>", "<p>two</p>"]
        for other in ("/2/", "/0/../report.json", "/etc/passwd"):
            with pytest.raises(urllib.error.HTTPError) as refused:
                read(other)
            assert refused.value.code == 404
            refused.value.close()
        server.shutdown()
