"""What a hidden effect is in the parameters of the library: the true values that a closed loop may find."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorid_torch.simulation.helicopter.aircraft import Aircraft
from rotorid_torch.simulation.helicopter.hidden import RATE_LIMIT, TILT, WIND, all_mass


def true_parameters(clean: Aircraft, hidden: Sequence[str], size: float) -> dict[str, float]:
    """True values by full name, SI, for the hidden effects whose physics has the library's form.

    Where the aircraft's physics is not the library's term (inflow, stall, interference) there is no true value.

    Parameters
    ----------
    clean : the aircraft without them. size : factor of their typical size.
    """
    heading = np.deg2rad(40.0)
    drag = 0.5 * clean.air_density * np.asarray(clean.fuselage.drag_area) / all_mass(clean)
    true: dict[str, dict[str, float]] = {
        "control.delay": {"common": 0.06},
        "control.lag": {"common": 0.08},
        "control.rate_limit": {"inverse": 1.0 / RATE_LIMIT},
        "control.backlash": {"width": 0.007},
        "rotor.wake_distortion": {"K_R": 1.5},
        "forces.drag": {"x": 1.5 * drag[0], "y": 0.2 * drag[1]},
        "forces.quadratic_damping": {"L": 1.5, "M": 1.0, "N": 1.5},
        "environment.ground": {"strength": 1.0},
        "environment.wind": {"north": -WIND * np.cos(heading), "east": -WIND * np.sin(heading)},
        "environment.turbulence": {"intensity": 1.0},
        "mass.payload": {"extra": 0.08 * all_mass(clean)},
        "mass.cg": {"x": 0.02 * clean.rotor.radius, "y": 0.005 * clean.rotor.radius},
        "mass.inertia": dict.fromkeys(("Ixx", "Iyy", "Izz", "Ixz"), 0.15),
        "mass.slung_load": {"ratio": 0.08 * all_mass(clean) / clean.mass},
        "sensors.bias": {"p": 0.01, "q": -0.007, "r": 0.005},
        "sensors.scale": {"p": 0.05, "q": 0.05, "r": 0.05},
        "sensors.misalignment": {"x": TILT / 3, "y": 2 * TILT / 3, "z": 2 * TILT / 3},
        "sensors.lever_arm": {"x": 0.3, "y": 0.1, "z": -0.25},
        "sensors.delay": {"rates": 0.06},
        "sensors.filter": {"rates": 0.05},
    }
    return {f"{e}.{name}": float(size * value) for e in hidden for name, value in true.get(e, {}).items()}
