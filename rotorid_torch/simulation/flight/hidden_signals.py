"""What the truth of an altered aircraft's flight tells beyond the usual channels: the `effect_*` channels."""

import numpy as np

from rotorid_torch.simulation.flight.motion import Outside, blade_angles, ground_part, moving_air
from rotorid_torch.simulation.helicopter.aircraft import CONTROL_NAMES, EULER, Aircraft
from rotorid_torch.simulation.rigid import Array


def hidden_signals(aircraft: Aircraft, x: Array, dx: Array, outside: Outside) -> dict[str, Array]:
    """Signals of one instant, [flight] each; none for a clean aircraft.

    `effect_lon` ... `effect_ped`: angles at the blades, rad; `effect_wind_u` ...: velocity of the air, body axes, m/s;
    `effect_curvature_c`, `_s`: curvature of the wake (aft, right); `effect_swing_x`, `_y`: angle of the cable forward
    and to the right of the vertical, rad; `effect_ground`: part of the induced velocity that the ground takes away.

    x, dx : [states, flight] and their rates.
    """
    out: dict[str, Array] = {}
    if aircraft.path is not None:
        angles, _ = blade_angles(aircraft, x, dx, outside)
        out |= {f"effect_{name}": angle for name, angle in zip(CONTROL_NAMES, angles, strict=True)}
    air = moving_air(aircraft, x, outside)
    if air is not None:
        out |= {f"effect_wind_{name}": speed for name, speed in zip("uvw", air, strict=True)}
    if aircraft.wake.distortion:
        out |= dict(zip(("effect_curvature_c", "effect_curvature_s"), x[aircraft.curvature_rows], strict=True))
    if aircraft.load is not None:
        north, east, _, _ = x[aircraft.swing_rows]
        cosine, sine = np.cos(x[EULER][2]), np.sin(x[EULER][2])
        down = np.sqrt(np.maximum(1.0 - north * north - east * east, 0.01))
        out["effect_swing_x"] = np.arctan2(north * cosine + east * sine, down)
        out["effect_swing_y"] = np.arctan2(east * cosine - north * sine, down)
    if aircraft.wake.ground:
        out["effect_ground"] = ground_part(aircraft, x)
    return out
