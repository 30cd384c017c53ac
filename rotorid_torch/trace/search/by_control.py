"""By how much controls differ: an effect of the control path, found for each of them by itself.

What a model lacks looks like a delay of one control and like a lead of another. Where controls differ by more than
their own errors, a common value is known no better than they agree.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec

from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.statistics import variance_between
from rotorid_torch.printable import significant
from rotorid_torch.trace.evidence.fits import Fitted, refit


@dataclass(frozen=True)
class ByControl:
    """The parameter that controls have in common, its unit, and the value and standard error of each control's own."""

    parameter: str
    unit: str
    sizes: Mapping[str, tuple[float, float]]

    @property
    def between(self) -> float:
        """Standard deviation of the controls' own values beyond their errors; zero where no two have an error."""
        errors = self._errors
        return math.sqrt(variance_between([v for v, _ in self.sizes.values()], errors)) if errors else 0.0

    @property
    def spread(self) -> float:
        """Standard error of a common value by the controls' differences, each weighing as much as it tells."""
        weights = [error**-2 for error in self._errors]
        return self.between * math.hypot(*weights) / max(sum(weights), 1e-300)

    @property
    def _errors(self) -> list[float]:
        """Standard errors, empty for fewer than two; a value at its bound, which has none, is known as the worst."""
        finite = [e for _, e in self.sizes.values() if 0.0 < e < math.inf]
        return [e if e in finite else max(finite) for _, e in self.sizes.values()] if len(finite) > 1 else []

    def __str__(self) -> str:
        """In words."""
        sizes = (
            f"{c} {v:.3g} ({f'± {significant(e)}' if e < math.inf else 'at its bound'})"
            for c, (v, e) in self.sizes.items()
        )
        return f"control by control {', '.join(sizes)}{'' if self.unit == '1' else ' ' + self.unit}"


def sizes_of_each(fitted: Fitted, effect: str) -> tuple[Parameter, dict[str, float]] | None:
    """An effect's parameter that all controls have in common, and for each of them one of its own that is as large.

    None where the model has no such.
    """
    declared = fitted.model.parameter_set.sizes(effect)
    each = [f"{effect}.{c}" for c in fitted.spec.controls]
    common, names = next((p for p in declared if p.name not in each), None), {p.name for p in declared}
    if common is None or not names.issuperset(each):
        return None
    return common, dict.fromkeys(each, fitted.values[common.name])


def by_control(final: Fitted, effect: str, held: Sequence[str]) -> ByControl | None:
    """The effect's parameter for each control, the rest fitted again; None where not all controls have one in common.

    final : a model with the effect. held : parameters that keep their values.
    """
    declared = sizes_of_each(final, effect)
    if declared is None or len(declared[1]) < 2 or declared[0].name not in final.names:
        return None
    common, sizes = declared
    names = {name.removeprefix(f"{effect}."): name for name in sizes}
    free = {**final.spec.free, common.name: False, **dict.fromkeys(sizes, True)}
    start = {**final.values, common.name: common.value, **sizes}
    refitted = refit(msgspec.structs.replace(final.spec, free=free), final.flights, start, held, near=final)
    return ByControl(common.name, common.unit, {c: (refitted.values[n], refitted.error(n)) for c, n in names.items()})
