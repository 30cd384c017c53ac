"""Writing what a run found into its folder: report.json, report.html, figures."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.figure import Figure

from rotorid_torch.report.figures import draw
from rotorid_torch.report.loop_figures import draw_loop
from rotorid_torch.report.page.document import Shown, render
from rotorid_torch.report.records import Report, encode_report
from rotorid_torch.run.output.monitor import Monitor

DPI = 130


def write_report(folder: Path, report: Report, shown: Shown | None = None, monitor: Monitor | None = None) -> None:
    """Write figures/NAME.png, report.html and report.json into a run's folder; the figures also for TensorBoard.

    Parameters
    ----------
    folder : the folder that `run_folder` gave.
    shown : flights and model that the page shows.
    monitor : where TensorBoard records; None records nothing.
    """
    shown = shown or Shown()
    drawn = {**draw_loop(report.effects, shown.before, shown.overlays), **draw(shown.overlays, report.fit)}
    (folder / "figures").mkdir(exist_ok=True)
    for name, figure in drawn.items():
        content = png(figure)
        (folder / "figures" / f"{name}.png").write_bytes(content)
        if monitor:
            monitor.picture(name, content)
    (folder / "report.html").write_text(render(report, shown), encoding="utf-8")
    (folder / "report.json").write_bytes(encode_report(report))


def png(figure: Figure) -> bytes:
    """Return the figure's picture, without a date in it."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return buffer.getvalue()
