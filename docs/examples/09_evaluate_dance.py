"""Evaluate a dance and see its worst moments.

A pupil of another build makes one mistake of each of the four kinds. Five takes of the teacher say how much may differ.
"""

import matplotlib.pyplot as plt

from dousa.evaluation import assess
from dousa.motion import canonicalise
from dousa.motion.synthetic import Performer, make_dance, make_mistakes

teacher = Performer("teacher")
takes = [canonicalise(make_dance(teacher, seed=take).motion) for take in range(5)]
performed, mistakes = make_mistakes(make_dance(Performer("pupil", seed=7), seed=9), seed=2)
pupil = canonicalise(performed)

judged = assess(takes, pupil)
print(f"grade {judged.score:.0f} of 100; errors, worst first:")
for event in sorted(judged.events, key=lambda event: -event.severity):
    where = ", ".join(event.segments) if len(event.segments) < 9 else "whole body"
    print(f"{event.start_s:5.1f} s  {event.kind:10}  severity {event.severity:.1f}  {where}")

figure, axes = plt.subplots(figsize=(9, 3.6), layout="constrained")
axes.plot(judged.times, judged.d_space, color="#0072b2", label="distance from the teacher's eigenspace, d#")
axes.plot(judged.times, judged.d_space_limit, color="#333333", ls="--", lw=1, label="limit")
for number, event in enumerate(judged.events):
    label = None if number else "found"
    axes.axvspan(event.start_s, event.end_s, color="#d55e00", alpha=0.25, label=label)
    axes.text((event.start_s + event.end_s) / 2, -0.1, event.kind, ha="center", va="center")
for number, error in enumerate(mistakes):
    axes.plot([error.start_s, error.end_s], [0, 0], color="#333333", lw=5, label=None if number else "put in")
axes.set(xlabel="s", ylim=(-0.2, None), title=f"Grade {judged.score:.0f}: where the pupil differs")
axes.legend(loc="upper right")
figure.savefig("dance.png", dpi=120)
