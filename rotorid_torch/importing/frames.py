"""What a log cannot know of a vehicle, as a table to fill in: mass, inertia, and the motors' places by its frame.

Source: ArduPilot, AP_MotorsMatrix.cpp (order, angle and spin of the motors by FRAME_CLASS and FRAME_TYPE); PX4 User
Guide, "Airframe Reference", has the same orders; Betaflight, mixer QUADX.
"""

import math
import re
from collections.abc import Iterator, Mapping

Arms = tuple[tuple[float, str], ...]
"""Angle of each motor from the nose to the right, in degrees, and its spin seen from above."""


def _arms(angles: str, spins: str) -> Arms:
    words = {"l": "ccw", "r": "cw"}  # to the left, to the right
    return tuple((float(angle), words[spin]) for angle, spin in zip(angles.split(), spins, strict=True))


FRAMES: Mapping[str, Arms] = {
    "quad X": _arms("45 -135 -45 135", "llrr"),
    "quad +": _arms("90 -90 0 180", "llrr"),
    "quad H": _arms("45 -135 -45 135", "rrll"),
    "quad X in Betaflight's order": _arms("135 45 -135 -45", "rllr"),
    "hexa X": _arms("90 -90 -30 150 30 -150", "rlrllr"),
    "hexa +": _arms("0 180 -120 60 -60 120", "rlrllr"),
    "octa X": _arms("22.5 -157.5 67.5 157.5 -22.5 -112.5 -67.5 112.5", "rrllllrr"),
    "octa +": _arms("0 180 45 135 -45 -135 -90 90", "rrllllrr"),
    "coaxial octa X": _arms("45 -45 -135 135 -45 45 135 -135", "lrlrlrlr"),
    "coaxial octa +": _arms("0 -90 180 90 -90 0 90 180", "lrlrlrlr"),
    "coaxial octa H": _arms("45 -45 -135 135 -45 45 135 -135", "rlrlrlrl"),
}
"""Motors by frame, in their order."""
CLASSES = {1: "quad", 2: "hexa", 3: "octa", 4: "coaxial octa"}
NAMED = {"QUAD": 4, "HEXA": 6, "OCTA": 8, "OCTA_QUAD": 8, "Y6": 6}
CLASSED = {1: 4, 2: 6, 3: 8, 4: 8, 5: 6, 12: 12, 14: 10}
"""Motors by the name of a frame, and by FRAME_CLASS."""
TYPES = {0: "+", 1: "X", 3: "H", 12: "X in Betaflight's order"}
STARTS = {4: "quad X", 5: "quad +", 6: "hexa X", 7: "hexa +", 8: "octa X", 9: "octa +", 12: "coaxial octa X"}
"""Frame by the thousands of PX4's SYS_AUTOSTART."""
USUAL = {4: "quad X", 6: "hexa X", 8: "octa X"}
"""Frame by the number of motors, where the log names none."""


def of_ardupilot(settings: Mapping[str, float]) -> str:
    """Frame that FRAME_CLASS and FRAME_TYPE name; empty where they name none of `FRAMES`."""
    words = CLASSES.get(int(settings.get("FRAME_CLASS", 0))), TYPES.get(int(settings.get("FRAME_TYPE", -1)))
    frame = " ".join(word or "" for word in words)
    return frame if frame in FRAMES else ""


def motors_of_ardupilot(settings: Mapping[str, float], about: str) -> int:
    """Number of motors by FRAME_CLASS or by "Frame: QUAD" of older firmware; 0 where neither says it."""
    named = re.search(r"Frame: (OCTA_QUAD|QUAD|HEXA|OCTA|Y6)\b", about)
    return CLASSED.get(int(settings.get("FRAME_CLASS", 0)), NAMED[named[1]] if named else 0)


def motors_of_px4(settings: Mapping[str, float]) -> int:
    """Number of motors of the frame that SYS_AUTOSTART names; 0 where it names none."""
    return len(FRAMES.get(of_px4(settings), ()))


def of_px4(settings: Mapping[str, float]) -> str:
    """Frame that SYS_AUTOSTART names; empty where it names none of `FRAMES`."""
    return STARTS.get(int(settings.get("SYS_AUTOSTART", 0)) // 1000, "")


def template(motors: int | None, frame: str, declared: Mapping[str, object], settings: Mapping[str, str]) -> str:
    """Comment for [vehicle] of a dataset.toml: its keys and tables, with question marks where nothing is known.

    `motors` is None for a helicopter; `settings` has lines of TOML, by key, that those of a log give; keys of
    `declared` are left out.
    """
    lines = ["this table is yours to fill in: put numbers for the question marks and take the # away."]
    asked = {
        "mass": "mass = ?                        # kg",
        "inertia": "inertia = [[?, 0, 0], [0, ?, 0], [0, 0, ?]]   # kg m², [[Ixx, -Ixy, -Ixz], ...]",
        "imu": settings.get(
            "imu", "imu = [?, ?, ?]                 # m from the centre of gravity, forward, right, down"
        ),
    }
    if motors is None:
        asked["hub"] = "hub = [?, ?, ?]                 # m from the centre of gravity"
    lines += [line for key, line in asked.items() if key not in declared]
    if motors is None and "rotor" not in declared:
        lines += ["[vehicle.rotor]", "blades = ?", "radius = ?                      # m", "chord = ?"]
        lines += [
            settings.get("speed", "speed = ?                       # rad/s"),
            'direction = "ccw"               # from above',
        ]
    if motors and not {"motors", "frame"} & {*declared}:
        lines += _places(motors, frame)
    return "".join(f"# {line}\n" for line in lines)


def _places(motors: int, frame: str) -> Iterator[str]:
    """Lines with the motors' places on arms of 1 m."""
    named = frame if len(FRAMES.get(frame, ())) == motors else ""
    arms = FRAMES.get(named or USUAL.get(motors, ""))
    said = f"the log's settings name {named}" if named else "no setting names the frame"
    if arms is None:
        yield f"{said}; one table for each of the {motors} motors:"
        arms = (((360.0 / motors), "ccw"),)
    else:
        more = "" if named else f"; this is {USUAL[motors]}: look whether it is yours"
        yield f"{said}{more}. Arms of 1 m: scale them by yours."
    for angle, spin in arms:
        x, y = (round(f(math.radians(angle)), 4) + 0.0 for f in (math.cos, math.sin))
        yield "[[vehicle.motors]]"
        yield f"position = [{x:g}, {y:g}, 0.0]"
        yield f'spin = "{spin}"'
