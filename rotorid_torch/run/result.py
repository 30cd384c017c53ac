"""What `identify` returns to Python: the model, what was found about it, and ways to look at it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from rotorid_torch.model.model import Model
from rotorid_torch.run import figures
from rotorid_torch.run.figures import Overlay
from rotorid_torch.run.html import number, render
from rotorid_torch.run.records import EffectRecord, FitRecord, Report, ScoresRecord, VerdictRecord, encode_report
from rotorid_torch.run.write import png


@dataclass(frozen=True)
class Run:
    """A finished identification.

    Attributes
    ----------
    model : the identified model.
    record : what report.json holds.
    overlays : free runs beside their measurement, one per flight.
    folder : where the run was written; None if it was not.
    """

    model: Model
    record: Report
    overlays: tuple[Overlay, ...] = ()
    folder: Path | None = None

    @property
    def before(self) -> FitRecord:
        """The fit before any effect was added."""
        if self.record.before is None:
            raise ValueError(f"a run of {self.record.command} has no fit")
        return self.record.before

    @property
    def after(self) -> FitRecord | None:
        """The fit after closing the loop; None where it was not closed."""
        return self.record.after

    @property
    def fit(self) -> FitRecord:
        """The fit that counts: parameters, modes, scores of every flight and channel."""
        return self.after or self.before

    @property
    def scores(self) -> ScoresRecord:
        """J of the lists identify, validate and acid."""
        return self.fit.scores

    @property
    def verdict(self) -> VerdictRecord | None:
        """The statement about undeclared effects; None where nothing was traced."""
        return self.record.verdict

    @property
    def effects(self) -> tuple[EffectRecord, ...]:
        """What was found about each effect."""
        return self.record.effects

    def table(self) -> str:
        """The parameters as text: name, value, standard error, unit, status; nuisance parameters left out."""
        shown = [p for p in self.fit.parameters if p.status != "nuisance"]
        rows = [("parameter", "value", "standard error", "unit", "status")]
        for p in shown:
            rows.append((p.name, number(p.value), number(p.se, 2), p.unit, p.status + " (at bound)" * p.at_bound))
        widths = [max(len(row[k]) for row in rows) for k in range(5)]
        return "\n".join("  ".join(map(_padded, row, widths, "<>><<")).rstrip() for row in rows)

    def plot(self) -> dict[str, Figure]:
        """Every picture of the report, by name."""
        return figures.draw(self.overlays, self.fit)

    def report(self, path: str | Path) -> Path:
        """Write the report to `path`: the page, or where it ends in .json the numbers."""
        path = Path(path)
        if path.suffix == ".json":
            path.write_bytes(encode_report(self.record))
        else:
            pictures = {name: png(figure) for name, figure in self.plot().items()}
            path.write_text(render(self.record, pictures), encoding="utf-8")
        return path


def _padded(text: str, width: int, side: str) -> str:
    return f"{text:{side}{width}}"
