"""Writing what a run found into its folder: report.json, report.html, figures."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from rotorid_torch.report.figures import Overlay, draw
from rotorid_torch.report.html import render
from rotorid_torch.report.loop_figures import draw_loop
from rotorid_torch.report.records import Report, encode_report
from rotorid_torch.run.output.monitor import Monitor

DPI = 130


def write_report(
    folder: Path,
    report: Report,
    overlays: Sequence[Overlay] = (),
    monitor: Monitor | None = None,
    before: Sequence[Overlay] = (),
) -> None:
    """Write figures/NAME.png, report.html and report.json into a run's folder; the figures also for TensorBoard.

    Parameters
    ----------
    folder : the folder that `run_folder` gave.
    overlays : free runs of the flights that are to be shown, any lists.
    before : the same of the model before the loop was closed.
    monitor : where TensorBoard records; None records nothing.
    """
    drawn = {**draw_loop(report.effects, before, overlays), **draw(overlays, report.fit)}
    pictures = {name: png(figure) for name, figure in drawn.items()}
    (folder / "figures").mkdir(exist_ok=True)
    for name, content in pictures.items():
        (folder / "figures" / f"{name}.png").write_bytes(content)
        if monitor:
            monitor.picture(name, content)
    (folder / "report.html").write_text(render(report, pictures), encoding="utf-8")
    (folder / "report.json").write_bytes(encode_report(report))


def png(figure: Figure) -> bytes:
    """Return the figure's picture, without a date in it."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return buffer.getvalue()
