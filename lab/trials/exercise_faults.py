"""Is the joint named that is at fault? Incorrect repetitions of UI-PRMD beside references by other people.

    python -m lab.trials.exercise_faults [--data DIR] [--sensors NAME ...] [--people N ...] [--every N]

``AT_FAULT`` was written down from the description of the incorrect movements alone, before anything was measured:
Vakanski, Jun, Paul, Baker, "A data set of human body movements for physical rehabilitation exercises", Data 3(1), 2,
2018, table of movements. Head and neck are counted with the trunk, the pelvis with the trunk and the hip.
"""

from __future__ import annotations

AT_FAULT = {
    "m01": {"trunk", "hip", "knee"},  # deep squat: trunk not upright or bent over 30 deg, not past parallel, valgus
    "m02": {"trunk", "hip"},  # hurdle step: trunk not upright, hip flexion under 89 deg, femur not neutral
    "m03": {"trunk", "knee", "hip"},  # inline lunge: trunk not upright, rear knee, step deviates to the side
    "m04": {"trunk", "knee", "hip"},  # side lunge: valgus, pelvis over 5 deg, trunk over 30 deg, thigh over 45 deg
    "m05": {"trunk", "hip", "knee"},  # sit to stand: trunk not upright, pelvis over 5 deg, weight on one side
    "m06": {"trunk", "hip", "knee"},  # straight leg raise: pelvis over 5 deg, knee bends, hip flexion under 59 deg
    "m07": {"trunk", "shoulder"},  # shoulder abduction: trunk or head not upright, under 160 deg, out of the plane
    "m08": {"trunk", "shoulder"},  # shoulder extension: the same, under 45 deg
    "m09": {"trunk", "shoulder"},  # shoulder rotation: the same, under 60 deg
    "m10": {"trunk", "shoulder"},  # shoulder scaption: the same, under 90 deg
}
"""Movement -> joints at fault in its incorrect repetitions; arms stay straight or bent as told, so no elbow is."""
