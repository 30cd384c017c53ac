"""`rotorid show` in a browser: runs beside each other, their reports, and TensorBoard, on this machine alone."""

import os
import sys
import webbrowser
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from rotorid_torch.report.page.document import rendered
from rotorid_torch.report.records import Report
from rotorid_torch.report.short_horizon import short_horizon
from rotorid_torch.report.words.verdict import Grade, grades, opening

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class Row:
    """A run in the table that compares runs."""

    name: str
    link: str
    report: Report
    opening: str
    grade: Grade | None
    validate: float | None
    acid: float | None


def comparison(reports: Mapping[str, Report], board: str = "") -> str:
    """The page that compares runs; run k is linked as /k/. board : address of TensorBoard."""
    rows = []
    for k, (name, report) in enumerate(reports.items()):
        flown = report.fit is not None and not short_horizon(report.fit)  # free runs of others mean nothing
        graded, scores = grades(report), report.fit.scores if report.fit and flown else None
        J = (scores.validate, scores.acid) if scores else (None, None)
        last = graded[-1] if graded else None
        rows.append(Row(Path(name).name, f"/{k}/", report, opening(report), last, *J))
    return rendered("compare.html.j2", rows=rows, board=board)


def server_of(page: str, runs: Sequence[Path]) -> ThreadingHTTPServer:
    """A server of the page at / and of each run's report at /k/, on loopback, at a port that is free."""
    places = {f"/{k}/": run / "report.html" for k, run in enumerate(runs)}

    class Pages(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            place = places.get(self.path)
            exists = self.path == "/" or (place is not None and place.is_file())
            content = page.encode() if place is None else place.read_bytes() if exists else b""
            self.send_response(200 if exists else 404)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(content) if exists else 0))
            self.end_headers()
            self.wfile.write(content if exists else b"")

        def log_message(self, format: str, *args: object) -> None:
            """Say nothing: the terminal is the user's."""

    return ThreadingHTTPServer((LOOPBACK, 0), Pages)


def serve(reports: Mapping[str, Report]) -> None:
    """Serve runs and their TensorBoard until Ctrl-C, and open the browser where there is one."""
    runs = [Path(run).absolute() for run in reports]
    with server_of(comparison(reports, _board(runs)), runs) as server:
        address = f"http://{LOOPBACK}:{server.server_address[1]}/"
        print(f"{len(runs)} run{'s' if len(runs) > 1 else ''} at {address}, until Ctrl-C", flush=True)
        if sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
            webbrowser.open(address)
        server.serve_forever()


def _board(runs: Sequence[Path]) -> str:
    """Address of a TensorBoard of the runs; empty where it does not start."""
    from tensorboard import program

    folders = ",".join(f"{run.name}:{run / 'tensorboard'}" for run in runs)
    board = program.TensorBoard()
    try:
        board.configure(argv=["tensorboard", "--logdir_spec", folders, "--host", LOOPBACK, "--port", "0"])
        return board.launch()
    except Exception:
        return ""
