"""Writing what a run found into its folder: report.json, report.html, figures."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from rotorid_torch.core.processes.forks import forked
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.report.overlay import Overlay, mean_spectra
from rotorid_torch.report.page.document import Shown, render
from rotorid_torch.report.page.tables import evidence_rows
from rotorid_torch.report.records import DatasetRecord, FitRecord, Report, encode_report
from rotorid_torch.report.words.verdict import consequence, opening
from rotorid_torch.run.output.monitor import Monitor, peak_memory_mb

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rotorid_torch.run.output.board import Board

DPI = 130


def write_report(folder: Path, report: Report, shown: Shown | None = None, monitor: Monitor | None = None) -> None:
    """Write figures/NAME.png, report.html and report.json into a run's folder; the figures also for TensorBoard.

    folder : the folder that `run_folder` gave.
    shown : flights and model that the page shows.
    monitor : where TensorBoard records; None records nothing.
    """
    shown = shown or Shown()
    drawn = [forked(partial(_drawn, report, shown, slice(part, None, 2))) for part in range(2)]
    if monitor and monitor.board:
        _tell(report, monitor, monitor.board)
        for title, overlays in (("before", shown.before), ("after" if report.after else "before", shown.overlays)):
            _tell_spectra(title, overlays, monitor.board)
    (folder / "report.html").write_text(render(report, shown), encoding="utf-8")
    (folder / "report.json").write_bytes(encode_report(report))
    write_pictures(folder, {name: picture for part in drawn for name, picture in part().items()}, monitor)


def _drawn(report: Report, shown: Shown, part: slice) -> dict[str, bytes]:
    """Some of the pictures, by name."""
    from rotorid_torch.report.loop_figures import drawings_of_run  # slow to import

    drawings = drawings_of_run(report, shown.before, shown.overlays)
    return {name: png(drawing()) for name, drawing in list(drawings.items())[part]}


def write_pictures(folder: Path, pictures: Mapping[str, bytes], monitor: Monitor | None) -> None:
    """Write figures/NAME.png, for TensorBoard too."""
    (folder / "figures").mkdir(exist_ok=True)
    for name, content in pictures.items():
        (folder / "figures" / f"{name}.png").write_bytes(content)
        if monitor:
            monitor.picture(name, content)


def png(figure: Figure) -> bytes:
    """The figure's picture, without a date in it."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return buffer.getvalue()


def report_of(
    command: str, dataset: Dataset, seed: int, monitor: Monitor, fit: FitRecord | None, warnings: Sequence[str]
) -> Report:
    """What a command says of a data set, with the time and memory that were spent so far."""
    about = DatasetRecord(name=dataset.name, sha256=dataset.sha256)
    spent = {"time_s": monitor.time_record(), "peak_memory_mb": peak_memory_mb()}
    return Report(command=command, dataset=about, seed=seed, before=fit, warnings=tuple(warnings), **spent)


def _tell(report: Report, monitor: Monitor, board: Board) -> None:
    """Verdict, ranking, parameters and scores of the report for TensorBoard."""
    board.text("verdict", "\n\n".join(words for words in (opening(report), consequence(report)) if words))
    ranking = [f"| {r.effect.id} | {r.sign} | {r.speaks_for} | {r.against} |" for r in evidence_rows(report.effects)]
    if ranking:
        board.text("ranking", "\n".join(["| effect | verdict | for | against |", "|---|---|---|---|", *ranking]))
    if report.fit is not None:
        scores = {f"scores/{n}": J for n, J in msgspec.structs.asdict(report.fit.scores).items() if J is not None}
        board.settings(_settings(report, report.fit), list(scores))
        board.scalars(scores, 0)
    for effect in (e for e in report.effects if e.gain is not None):
        with monitor.fit(f"candidate-{effect.id}") as record:
            numbers = {"gain": effect.gain, "floor": effect.floor, "p": effect.p}
            numbers |= {f"parameters/{p.name}": p.value for p in effect.parameters}
            record({name: value for name, value in numbers.items() if value is not None}, 0)
    for title, fit in (("before", report.before), ("after", report.after)):
        if fit is None:
            continue
        rows = [f"| {p.name} | {p.value} | {p.se} | {p.unit} | {p.status} |" for p in fit.parameters]
        head = ["| parameter | value | standard error | unit | status |", "|---|---|---|---|---|"]
        board.text(f"parameters/{title}", "\n".join([*head, *rows]))
        scores = msgspec.structs.asdict(fit.scores)
        board.scalars({f"scores/{title}/{name}": J for name, J in scores.items() if J is not None}, 0)
        for flight, record in fit.flights.items():
            channels = record.channels.items()
            board.scalars({f"rmse/{title}/{flight}/{c}": r.rmse for c, r in channels if r.rmse is not None}, 0)
            board.scalars({f"theil/{title}/{flight}/{c}": r.theil for c, r in channels if r.theil is not None}, 0)


def _tell_spectra(title: str, overlays: Sequence[Overlay], board: Board) -> None:
    """Amplitudes of the residual by frequency, on flights that no fit has seen; steps are hundredths of a hertz."""
    spectra = {f"spectrum/{title}/{channel}": spectrum for channel, spectrum in mean_spectra(overlays).items()}
    for name, (hertz, amplitude) in spectra.items():
        steps = dict(zip((100.0 * hertz).round().astype(int).tolist(), amplitude.tolist(), strict=True))
        for place, size in steps.items():
            board.scalars({name: size}, place)


def _settings(report: Report, fit: FitRecord) -> dict[str, str | float]:
    """What a run was made with."""
    named = "" if report.verdict is None else ", ".join(report.verdict.effects)
    about = {"command": report.command, "data set": report.dataset.name, "seed": report.seed, "method": fit.method}
    free = sum(p.status == "free" for p in fit.parameters)
    return {**about, "effects": named, "free parameters": free}
