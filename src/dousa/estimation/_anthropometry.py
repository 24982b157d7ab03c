"""The tables a human body is made from: lengths, breadths and girths in shares of stature, and joint ranges.

Lengths: Drillis and Contini (1966) as tabulated in Winter, "Biomechanics and Motor Control of Human Movement",
moved to where motion capture puts the joints: the pelvis is the root of an ASF file, well above the hips and a
little behind them; hips and shoulders are the centres of the balls, nearer to the middle than the widths that a tape
gives; the head ends inside the skull, the toe is the ball of the foot. Where the skeletons of four recorded people
(HDM05, CMU) agree on something else than the table (the arms), they were followed. Solids: drawn by hand, then moved
until their outlines fitted the rendered people of silhouette_bench/ and seventeen more renderings of the same kind
best; the result is a slender person in thin clothes, whose girths are measured off the solids. Their spheres are few
on purpose, 39 in all: each is projected for every candidate pose, and twenty more would fit the outlines of
silhouette_bench/ by less than one hundredth better. Ranges: AAOS (1965) and Kapandji, "The Physiology of the Joints",
widened for dancers. Agility and stiffness: set by hand.

At rest a person faces +Z, left is +X, up is +Y; everything here is the left side or the middle.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "GIRTHS",
    "LENGTHS",
    "PARTS",
    "SEX_FACTORS",
    "TIPS",
    "PartTable",
]

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class PartTable:
    """A part of the left half or the middle of the average body.

    Parameters
    ----------
    name, joint, parent : without their side.
    offset : statures, the joint in the parent's axes, which are the world's in the standing pose.
    rest : rad, rotation vector of the part's axes in the parent's at angle zero.
    axes : unit vectors in the part's axes.
    limits : rad, least and greatest angle of each axis.
    spheres : statures, (x, y, z, radius); a middle part's left half, whose spheres off the middle are doubled.
    girths : of each sphere, the name of the girth that widens it, or "" for none.
    agility, stiffness : see `BodyModel`.
    """

    name: str
    joint: str
    parent: str
    offset: Triple
    rest: Triple
    axes: tuple[Triple, ...]
    limits: tuple[tuple[float, float], ...]
    spheres: tuple[tuple[float, float, float, float], ...]
    girths: tuple[str, ...]
    agility: float
    stiffness: float


_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_BACK = (-1.0, 0.0, 0.0)
# Inman (1976): the axis below the ankle rises by 42 degrees to the front; its turn inwards is left out, so that it is
# square to the ankle's own. It also stands in for the turn of the shank in the bent knee, hence its wide range.
_SUBTALAR = (0.0, 0.6691306063588582, 0.7431448254773942)
_NONE = (0.0, 0.0, 0.0)

# fmt: off
PARTS: tuple[PartTable, ...] = (
    PartTable(
        "pelvis", "pelvis", "", _NONE, _NONE, (), (),
        (
            (0.030, -0.064, 0.008, 0.051), (0.026, 0.026, 0.024, 0.057),
        ),
        ("hip_girth", "hip_girth"),
        0.65, 0.0,
    ),
    # Forward bend, bend to the side, turn: 90, 46 and 63 degrees and 46 back (AAOS: 80, 35, 45, 30).
    PartTable(
        "trunk", "spine", "pelvis", (0.0, 0.072, 0.0), _NONE, (_X, _Z, _Y), ((-0.8, 1.6), (-0.8, 0.8), (-1.1, 1.1)),
        (
            (0.020, -0.015, 0.040, 0.041), (0.000, 0.076, 0.036, 0.057), (0.089, 0.166, -0.009, 0.035),
            (0.000, 0.174, 0.003, 0.048),
        ),
        ("waist_girth", "chest_girth", "", ""),
        0.65, 1.0,
    ),
    # Neck: 69 forward, 74 back, 52 to the side, 86 round (AAOS: 45, 45, 45, 60).
    PartTable(
        "head", "neck", "trunk", (0.0, 0.198, 0.0), _NONE, (_X, _Z, _Y), ((-1.3, 1.2), (-0.9, 0.9), (-1.5, 1.5)),
        (
            (0.000, -0.002, 0.027, 0.032), (0.000, 0.082, 0.039, 0.045), (0.000, 0.095, 0.018, 0.045),
        ),
        ("", "", ""),
        0.85, 1.0,
    ),
    # The zero lies in the middle of where an arm can point: to the side, forward and a little down. The box holds
    # every direction that flexion 180, extension 60, abduction 180 and the reach across the chest lead to.
    PartTable(
        "upper_arm", "shoulder", "trunk", (0.122, 0.165, -0.008), (-0.6, 0.0, 1.0), (_X, _Z, _Y),
        ((-2.2, 2.2), (-2.15, 2.3), (-3.0, 3.0)),
        (
            (-0.003, -0.006, -0.003, 0.030), (-0.004, -0.159, 0.000, 0.018),
        ),
        ("upper_arm_girth", "upper_arm_girth"),
        1.5, 1.0,
    ),
    # Elbow: 155 degrees and 6 past straight (AAOS: 150, 0).
    PartTable(
        "forearm", "elbow", "upper_arm", (0.0, -0.162, 0.0), _NONE, (_BACK,), ((-0.1, 2.7),),
        (
            (-0.001, -0.007, 0.005, 0.021), (-0.001, -0.164, -0.004, 0.011),
        ),
        ("forearm_girth", "forearm_girth"),
        1.8, 0.3,
    ),
    # Wrist: the forearm of the model does not turn about itself, so both ways get nearly the range of flexion.
    PartTable(
        "hand", "wrist", "forearm", (0.0, -0.158, 0.0), _NONE, (_Z, _X), ((-1.3, 1.3), (-1.0, 1.0)),
        (
            (0.000, -0.016, 0.003, 0.018), (0.000, -0.063, 0.006, 0.012),
        ),
        ("", ""),
        1.0, 1.0,
    ),
    # The zero lies in the middle of where a thigh can point, forward and out; the box holds flexion 145, extension 45,
    # abduction 100 and adduction 40 (AAOS: 120, 30, 45, 30; dancers reach the rest).
    PartTable(
        "thigh", "hip", "pelvis", (0.045, -0.062, 0.018), (-0.8, 0.0, 0.4), (_X, _Z, _Y),
        ((-1.75, 1.9), (-1.2, 1.65), (-1.8, 1.8)),
        (
            (-0.009, -0.011, 0.015, 0.057), (-0.002, -0.227, 0.004, 0.030),
        ),
        ("thigh_girth", "thigh_girth"),
        1.2, 1.0,
    ),
    # Knee: 160 degrees and 9 past straight (AAOS: 135, 10; sitting on the heels reaches 155).
    PartTable(
        "shank", "knee", "thigh", (0.0, -0.236, 0.0), _NONE, (_X,), ((-0.15, 2.8),),
        (
            (0.005, -0.025, -0.017, 0.035), (0.006, -0.233, -0.005, 0.015),
        ),
        ("calf_girth", "calf_girth"),
        1.7, 0.3,
    ),
    # Ankle: 52 degrees up, 74 down as on pointe (AAOS: 20, 50); in and out 46 (35, 20), see above.
    PartTable(
        "foot", "ankle", "shank", (0.0, -0.246, 0.0), _NONE, (_X, _SUBTALAR), ((-0.9, 1.3), (-0.8, 0.8)),
        (
            (0.000, -0.027, -0.010, 0.014), (0.000, -0.005, 0.000, 0.019), (0.002, -0.020, 0.086, 0.014),
        ),
        ("", "", ""),
        1.0, 1.0,
    ),
)
# fmt: on
"""From the root outwards."""

TIPS: dict[str, tuple[str, Triple]] = {
    "head": ("head", (0.0, 0.102, 0.014)),
    "hand": ("hand", (0.0, -0.042, 0.0)),
    "toe": ("foot", (0.0, -0.024, 0.074)),
}
"""Further points: name -> part and statures in its axes; the hand is the knuckles, where recordings have it."""

LENGTHS: dict[str, float] = {
    "upper_arm": 0.162,
    "forearm": 0.158,
    "hand": 0.106,
    "thigh": 0.236,
    "shank": 0.246,
    "foot": 0.150,
    "head": 0.126,
    "trunk": 0.332,
    "shoulder_breadth": 0.244,
    "hip_breadth": 0.090,
}
"""Statures: from joint to joint; the hand to the finger tips, the foot from heel to tip, the head from chin to crown,
the trunk from between the hips to the base of the neck, the breadths between the joints of both sides."""

GIRTHS: dict[str, float] = {
    "chest_girth": 0.545,
    "waist_girth": 0.426,
    "hip_girth": 0.524,
    "thigh_girth": 0.312,
    "calf_girth": 0.195,
    "upper_arm_girth": 0.157,
    "forearm_girth": 0.131,
}
"""Statures round the solids of the average body, clothes included."""

SEX_FACTORS: dict[str, dict[str, float]] = {
    "average": {},
    "female": {
        "shoulder_breadth": 0.95,
        "hip_breadth": 1.05,
        "chest_girth": 0.97,
        "waist_girth": 0.95,
        "hip_girth": 1.04,
        "thigh_girth": 1.03,
        "upper_arm_girth": 0.95,
        "forearm_girth": 0.94,
        "head": 1.01,
        "trunk": 1.01,
    },
    "male": {
        "shoulder_breadth": 1.05,
        "hip_breadth": 0.96,
        "chest_girth": 1.03,
        "waist_girth": 1.04,
        "hip_girth": 0.97,
        "thigh_girth": 0.98,
        "upper_arm_girth": 1.05,
        "forearm_girth": 1.06,
        "head": 0.99,
        "trunk": 0.99,
    },
}
"""What women and men differ by from the average of both, as shares of it."""
