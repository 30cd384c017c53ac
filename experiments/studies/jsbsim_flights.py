"""What does the closed loop say of a helicopter that JSBSim flies? One line for each set, beside what the set hides.

JSBSim (Berndt and others) has an AH-1S: a rotor after Talbot and others (NASA TM-84281) with steady flapping and one
inflow, a rotor speed with governor, downwash on wing and tail. Its stick mixing and lags are taken out, so that blade
angles are set directly. A rate and attitude controller is active; the recorded angles have its part in them. What is
hidden acts between these and the rotor, on a cable below the vehicle, in the air, or in the records.

Expected: the causes named with their sizes, and nothing else. JSBSim is installed by whoever runs this:
`pip install --no-deps jsbsim`. A set takes 3 to 15 minutes of a processor.
"""

from __future__ import annotations

import json
import math
import shutil
import tempfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from recorded.closed import Args, close_loops
from recorded.lines import version
from scipy.spatial.transform import Rotation

import rotorid_torch as rotorid

RATE, SUBSTEPS = 154.0, 4
FOOT, POUND, SLUG, INCH = 0.3048, 4.4482216, 14.593903, 0.0254
CONTROLS = ("lon", "lat", "col", "ped")
ANGLES = ("engine/longitudinal", "engine/lateral", "engine/collective", "engine[1]/antitorque")
"""JSBSim's names of the blade angles of `CONTROLS`."""
PULSE = np.array([0.020, 0.014, 0.020, 0.036])
"""rad: test inputs, about 10 % of full deflection."""
LEAST, MOST = np.array([-0.105, -0.05, 0.02, -0.10]), np.array([0.145, 0.05, 0.36, 0.40])
HOVER, FORWARD = np.array([0.0, -0.005, 0.25, 0.14]), np.array([0.03, -0.007, 0.23, 0.09])
"""rad: where the controller starts to look for trim."""
FED = {"theta": (0, 0.10), "q": (0, 0.12), "phi": (1, -0.06), "p": (1, -0.05), "psi": (3, 0.20), "r": (3, 0.20)}
"""Place of the control that each angle and rate feeds, and gain, rad per rad or rad s."""
HEIGHT, CLIMB_S, SETTLE_S, AGAIN_S, QUIET_S = 27.4, 8.0, 60.0, 20.0, 1.0
GRAVITY, DENSITY, HOOK = 9.7972, 1.2248, np.array([0.0, 0.0, 1.5])
NOISE = {
    **dict.fromkeys(("p", "q", "r", "phi", "theta", "psi"), 0.002),
    **dict.fromkeys(("u", "v", "w", "ax", "ay", "az"), 0.05),
    **dict.fromkeys(("a0", "a1", "b1"), 0.001),
    **dict.fromkeys(CONTROLS, 0.0005),
    "height": 0.2,
    "omega": 0.02,
}
"""Standard deviations, SI."""
FLIGHTS = {
    "identify": [*(("f321", c, 1) for c in CONTROLS), *(("dbl", c, 1) for c in CONTROLS)],
    "validate": [("dbl", c, -1) for c in CONTROLS],
    "acid": [("sweep", "col", 1)],
}


@dataclass(frozen=True)
class Set:
    """Flights of the vehicle, and what acts besides.

    true : sizes of the effects that are hidden, by full name. speed : forward, m/s. late, lag : s. rate : rad/s that
    actuators do at most. play : rad. load : mass on a cable over the vehicle's, and length of the cable, m. gusts :
    intensity, m/s, and length, m. wind : north and east, m/s. attitude_late : s by which attitudes are recorded late.
    """

    true: Mapping[str, float]
    speed: float = 0.0
    late: float = 0.0
    lag: float = 0.0
    rate: float = math.inf
    play: float = 0.0
    load: tuple[float, float] = (0.0, 8.0)
    gusts: tuple[float, float] = (0.0, 50.0)
    wind: tuple[float, float] = (0.0, 0.0)
    headings: tuple[float, ...] = (0.0,)
    attitude_late: float = 0.0


KT60 = 31.0
SETS = {
    "hover": Set({}),
    "60 kt": Set({}, speed=KT60),
    "delay": Set({"control.delay.common": 0.045}, late=0.045),
    "delay, 60 kt": Set({"control.delay.common": 0.05}, late=0.05, speed=KT60),
    "short delay": Set({"control.delay.common": 0.025}, late=0.025),
    "lag": Set({"control.lag.common": 0.06}, lag=0.06),
    "lag, 60 kt": Set({"control.lag.common": 0.07}, lag=0.07, speed=KT60),
    "rate limit": Set({"control.rate_limit.common": 0.06}, rate=0.06),
    "play": Set({"control.backlash.common": 0.006}, play=0.006),
    "play, 60 kt": Set({"control.backlash.common": 0.005}, play=0.005, speed=KT60),
    "load": Set({"mass.slung_load.mass": 0.07, "mass.slung_load.length": 8.0}, load=(0.07, 8.0)),
    "load and delay": Set(
        {"mass.slung_load.mass": 0.06, "mass.slung_load.length": 10.0, "control.delay.common": 0.05},
        load=(0.06, 10.0),
        late=0.05,
    ),
    "gusts": Set({"environment.turbulence.intensity": 1.0}, gusts=(1.0, 50.0)),
    "gusts, 60 kt": Set({"environment.turbulence.intensity": 1.0}, gusts=(1.0, 100.0), speed=KT60),
    "gusts and delay": Set(
        {"environment.turbulence.intensity": 1.0, "control.delay.common": 0.05}, gusts=(1.0, 50.0), late=0.05
    ),
    "wind": Set(
        {"environment.wind.north": 5.0, "environment.wind.east": 3.0}, wind=(5.0, 3.0), headings=(0.0, 1.6, 3.1, 4.7)
    ),
    "late attitudes": Set({"sensors.delay.attitude": 0.06}, attitude_late=0.06),
}
"""By name."""


def test_input(kind: str, sign: int, t: float) -> float:
    """What is added to one control at a time, in units of its pulse: 3-2-1-1, doublet or sweep from 0.05 to 2 Hz."""
    t -= QUIET_S
    if kind == "sweep":
        return math.sin(2.0 * math.pi * (0.05 + 1.95 * t / 12.0) * t) if 0.0 < t < 6.0 else 0.0
    unit, steps = {"f321": (0.6, (1, 1, 1, -1, -1, 1, -1)), "dbl": (0.7, (1, -1))}[kind]
    k = math.floor(t / unit)
    return float(sign * steps[k]) if 0 <= k < len(steps) else 0.0


class Linkage:
    """What lies between recorded angles and rotor, step by step: delay, play, lag, rate limit."""

    def __init__(self, one: Set, step: float, angles: np.ndarray) -> None:
        """It begins at rest at these angles [4]; step : s."""
        self.one, self.step = one, step
        self.queue = [angles] * round(one.late / step)
        self.played, self.acts = angles, angles

    def __call__(self, angles: np.ndarray) -> np.ndarray:
        """Angles at the rotor [4]."""
        self.queue.append(angles)
        late, half = self.queue.pop(0), 0.5 * self.one.play
        self.played = np.clip(self.played, late - half, late + half)
        share = 1.0 - math.exp(-self.step / self.one.lag) if self.one.lag else 1.0
        most = self.one.rate * self.step
        self.acts = self.acts + np.clip(share * (self.played - self.acts), -most, most)
        return self.acts


class Load:
    """A mass on a cable, a pendulum of small swing in axes that do not turn."""

    def __init__(self, share: float, length: float, mass: float) -> None:
        self.mass, self.length = share * mass, length
        self.swing, self.rate = np.zeros(2), np.zeros(2)
        self.before: np.ndarray | None = None
        self.felt = np.zeros(3)

    def force(self, hook: np.ndarray, step: float) -> np.ndarray:
        """On the hook, N, along north, east and down; from the hook's velocity, m/s."""
        if self.before is not None:
            self.felt = self.felt + 0.3 * ((hook - self.before) / step - self.felt)  # s of few steps: no algebraic loop
        self.before = hook
        pull = GRAVITY - self.felt[2]
        self.rate = self.rate + step * (-pull / self.length * self.swing - self.felt[:2] - 0.04 * self.rate)
        self.swing = self.swing + step * self.rate
        return self.mass * pull * np.array([*(self.swing / self.length), 1.0])


def installed(place: Path) -> Path:
    """A copy of JSBSim's AH-1S without stick mixing, to which a load can be hung."""
    import jsbsim  # pyright: ignore[reportMissingImports]

    origin = Path(jsbsim.__file__).parent
    shutil.copytree(origin / "aircraft" / "ah1s", place / "aircraft" / "ah1s")
    for folder in ("engine", "systems"):
        shutil.copytree(origin / folder, place / folder)
    mixer, vehicle = place / "aircraft/ah1s/Systems/rotor_control.xml", place / "aircraft/ah1s/ah1s.xml"
    text = mixer.read_text()
    for k, name in enumerate(ANGLES):
        text = text.replace(f"<output> propulsion/{name}-ctrl-rad </output>", f"<output> fcs/unused-{k} </output>")
    mixer.write_text(text)
    hung = ""
    for k, axis in enumerate("xyz"):
        along = "".join(f"<{n}>{float(n == axis)}</{n}>" for n in "xyz")
        centre = '<location unit="IN"><x>172</x><y>0</y><z>75</z></location>'
        direction = f"<direction>{along}</direction>"
        hung += f'<force name="pull-{k}" frame="BODY">{centre}{direction}</force>'
        hung += f'<moment name="turn-{k}" frame="BODY">{direction}</moment>'
    reactions = f"<external_reactions>{hung}</external_reactions><propulsion>"
    vehicle.write_text(vehicle.read_text().replace("<propulsion>", reactions, 1))
    return place


class Craft:
    """JSBSim's AH-1S with running rotors, what is hidden in it, and a controller that brings it back to its trim."""

    def __init__(self, one: Set, root: Path, heading: float, chance: np.random.Generator) -> None:
        import jsbsim  # pyright: ignore[reportMissingImports]

        jsbsim.FGJSBBase().debug_lvl = 0
        self.one, self.heading, self.chance = one, heading, chance
        self.sim = jsbsim.FGFDMExec(str(root))
        for name in ("aircraft", "engine", "systems"):
            getattr(self.sim, f"set_{name}_path")(name)
        self.sim.load_model("ah1s")
        self.step = 1.0 / RATE / SUBSTEPS
        self.sim.set_dt(self.step)
        self.sim["ic/h-agl-ft"], self.sim["ic/psi-true-rad"] = 6.3, heading
        self.sim.run_ic()
        self.sim["propulsion/set-running"], self.sim["fcs/rpm-governor-active-norm"] = -1, 1.0
        self.sim["atmosphere/wind-north-fps"], self.sim["atmosphere/wind-east-fps"] = np.array(one.wind) / FOOT
        self.mass = self.sim["inertia/mass-slugs"] * SLUG
        self.load = Load(*one.load, self.mass) if one.load[0] else None
        self.air = np.zeros(3)
        self.missed = dict.fromkeys(("u", "v", "height", "theta", "phi", "psi"), 0.0)

    @property
    def motion(self) -> dict[str, float]:
        """States without noise, in our channels."""
        sim = self.sim
        named = {c: sim[f"velocities/{c}-fps"] * FOOT for c in "uvw"}
        named |= {c: sim[f"velocities/{c}-rad_sec"] for c in "pqr"} | {
            c: sim[f"attitude/{name}-rad"] for c, name in (("phi", "phi"), ("theta", "theta"), ("psi", "psi"))
        }
        turns = sim["propulsion/engine/rotor-rpm"] * math.pi / 30.0
        return named | {"height": sim["position/h-agl-ft"] * FOOT, "omega": turns}

    @property
    def felt(self) -> dict[str, float]:
        """Specific force, m/s2, and flapping, rad, of the last step."""
        sim, slugs = self.sim, self.sim["inertia/mass-slugs"]
        force = {f"a{axis}": sim[f"forces/fb{axis}-total-lbs"] / slugs * FOOT for axis in "xyz"}
        return force | {c: sim[f"propulsion/engine/{c}-rad"] for c in ("a0", "a1", "b1")}

    def fly(self, angles: np.ndarray, linkage: Linkage | None = None) -> None:
        """One sample with these angles recorded [4]."""
        for _ in range(SUBSTEPS):
            acts = angles if linkage is None else linkage(angles)
            for name, angle in zip(ANGLES, acts, strict=True):
                self.sim[f"propulsion/{name}-ctrl-rad"] = float(angle)
            if linkage is not None and self.one.gusts[0]:
                self._blow()
            if self.load is not None:
                self._pull(self.load)
            self.sim.run()

    def _blow(self) -> None:
        """Gusts of first order (Dryden's spectrum along the flight) for one step; in hover air passes at 5 m/s."""
        intensity, length = self.one.gusts
        kept = math.exp(-self.step * max(self.one.speed, 5.0) / length)
        self.air = kept * self.air + intensity * math.sqrt(1.0 - kept * kept) * self.chance.standard_normal(3)
        for axis, speed in zip(("north", "east", "down"), self.air, strict=True):
            self.sim[f"atmosphere/gust-{axis}-fps"] = speed / FOOT

    def _pull(self, load: Load) -> None:
        """Force and moment of a load for one step."""
        state = self.motion
        earth = Rotation.from_euler("ZYX", [state[c] for c in ("psi", "theta", "phi")])
        velocity, rates = (np.array([state[c] for c in names]) for names in ("uvw", "pqr"))
        force = earth.inv().apply(load.force(earth.apply(velocity + np.cross(rates, HOOK)), self.step))
        moment = np.cross(HOOK, force)
        for k in range(3):
            self.sim[f"external_reactions/pull-{k}/magnitude"] = force[k] / POUND
            self.sim[f"external_reactions/turn-{k}/magnitude-lbsft"] = moment[k] / POUND / FOOT

    def fed_back(self, state: Mapping[str, float], about: Mapping[str, float]) -> np.ndarray:
        """Angles of the rate and attitude controller [4]."""
        off = {name: state[name] - about.get(name, 0.0) for name in FED}
        off["psi"] = math.remainder(off["psi"], 2.0 * math.pi)
        angles = np.zeros(4)
        for name, (place, gain) in FED.items():
            angles[place] += gain * off[name]
        return angles

    def settle(self, seconds: float, start: np.ndarray, up: float) -> tuple[np.ndarray, dict[str, float]]:
        """Bring the vehicle to its speed, height and heading; returns angles [4] and attitudes of trim.

        up : s in which speed is taken up.
        """
        step, missed, last = 1.0 / RATE, self.missed, list[np.ndarray]()
        for k in range(round(seconds * RATE)):
            state, share = self.motion, min(1.0, k * step / up) if up else 1.0
            north, east = (self.sim[f"velocities/v-{n}-fps"] * FOOT for n in ("north", "east"))
            cosine, sine = math.cos(state["psi"]), math.sin(state["psi"])
            forward, right = north * cosine + east * sine - share * self.one.speed, east * cosine - north * sine
            above = float(np.clip(HEIGHT - state["height"], -4.0, 4.0))
            for name, error in (("u", forward), ("v", right), ("height", above)):
                missed[name] += error * step
            about = {
                "theta": float(np.clip(0.03 * forward + 0.006 * missed["u"], -0.35, 0.35)),
                "phi": float(np.clip(-0.03 * right - 0.006 * missed["v"], -0.25, 0.25)),
                "psi": self.heading,
            }
            for name in about:
                missed[name] += math.remainder(state[name] - about[name], 2.0 * math.pi) * step
            angles = start + self.fed_back(state, about)
            angles += [0.05 * missed["theta"], -0.03 * missed["phi"], 0.0, 0.05 * missed["psi"]]
            rising = self.sim["velocities/h-dot-fps"] * FOOT
            angles[2] += 0.006 * above - 0.012 * rising + 0.0015 * missed["height"]
            angles = np.clip(angles, LEAST, MOST)
            self.fly(angles)
            last.append(np.array([*angles, state["theta"], state["phi"]]))
        mean = np.mean(last[-round(8.0 * RATE) :], axis=0)
        return mean[:4], {"theta": float(mean[4]), "phi": float(mean[5]), "psi": self.heading}

    def record(self, kind: tuple[str, str, int], trim: tuple[np.ndarray, dict[str, float]], seconds: float) -> Any:
        """Channels of one flight from trim, without noise."""
        about, rows = trim[1], list[dict[str, float]]()
        linkage = Linkage(self.one, self.step, trim[0])
        for k in range(-round(2.0 * RATE), round(seconds * RATE) + 1):
            state = self.motion
            angles = trim[0] + self.fed_back(state, about)
            place = CONTROLS.index(kind[1])
            angles[place] += PULSE[place] * test_input(kind[0], kind[2], k / RATE)
            rows.append(dict(zip(CONTROLS, angles.tolist(), strict=True)) | state | self.felt)
            self.fly(angles, linkage)
        rows = rows[-round(seconds * RATE) :]
        return {"time": np.arange(len(rows)) / RATE} | {c: np.array([row[c] for row in rows]) for c in rows[0]}


def flown(one: Set, seconds: float, seed: int) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    """Flights of a set by name, with noise."""
    chance = np.random.default_rng(seed)
    kinds = [kind for some in FLIGHTS.values() for kind in some]
    with tempfile.TemporaryDirectory() as place:
        root = installed(Path(place))
        for turn, heading in enumerate(one.headings):
            craft = Craft(one, root, heading, chance)
            for _ in range(round(CLIMB_S * RATE)):
                craft.fly(np.array([0.02, 0.0, 0.05, 0.05]))
            start = FORWARD if one.speed else HOVER
            trim = craft.settle(SETTLE_S, start, 0.6 * SETTLE_S)
            for kind in kinds[turn :: len(one.headings)]:
                record = craft.record(kind, trim, seconds)
                craft.settle(AGAIN_S, start, 0.0)
                record["psi"] = np.unwrap(record["psi"])
                for c in ("phi", "theta", "psi") if one.attitude_late else ():
                    record[c] = np.interp(record["time"] - one.attitude_late, record["time"], record[c])
                noisy = {c: v + NOISE.get(c, 0.0) * chance.standard_normal(len(v)) for c, v in record.items()}
                yield name_of(kind), noisy


def name_of(kind: tuple[str, str, int]) -> str:
    """Of a flight."""
    return f"{kind[0]}_{kind[1]}_{'p' if kind[2] > 0 else 'n'}"


def data_set(name: str, args: Args) -> rotorid.Dataset:
    """Flights of a set, with mass, inertia and rotor declared as JSBSim has them."""
    one = SETS[name]
    records = dict(flown(one, args.seconds, zlib.crc32(f"{name} {args.seed}".encode())))
    lists = {listed: [name_of(kind) for kind in kinds] for listed, kinds in FLIGHTS.items()}
    rotor = {"blades": 2, "radius": 6.706, "chord": 0.6858, "speed": 33.93, "direction": "ccw"}
    vehicle = {
        "mass": 3855.54,
        "inertia": [[3515.6, 0.0, 0.0], [0.0, 19415.3, 0.0], [0.0, 0.0, 16717.2]],
        "gravity": GRAVITY,
        "air_density": DENSITY,
        "hub": [-4 * INCH, 0.0, -78 * INCH],
        "rotor": rotor | {"hinge_offset": 1.006, "lock_number": 5.4},
    }
    noise = {c: {"noise": size} for c, size in NOISE.items()}
    channels = {c: size for c, size in noise.items() if c not in CONTROLS}
    controls = {
        c: noise[c] | {"unit": "rad", "limits": [float(low), float(high)]}
        for c, low, high in zip(CONTROLS, LEAST, MOST, strict=True)
    }
    ordered = {name: records[name] for names in lists.values() for name in names}
    return rotorid.Dataset.from_arrays(
        ordered, **lists, kind="helicopter", name=f"ah1 {name}", vehicle=vehicle, controls=controls, channels=channels
    )


def main(args: Args) -> None:
    """Close the loop of every set that the record does not hold, and print the lines."""
    if args.quick:
        run = rotorid.identify(data_set("hover", replace(args, seconds=6.0)))
        print(json.dumps({"version": version(), "J": run.scores["validate"]}))
        return

    close_loops(args, data_set, lambda name: SETS[name].true)


if __name__ == "__main__":
    main(tyro.cli(Args, prog="experiments/studies/jsbsim_flights.py", default=Args.of(SETS, "jsbsim.jsonl")))
