"""Draw the pictures of the documents again, and print the table of features: ``make figures``.

Everything shown is made by the package itself: no recording is needed. `make_estimation_figures` and
`make_evaluation_figures` do the same for docs/estimation.md and docs/evaluation.md.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console

from dousa.app.demo import run_demo
from dousa.app.pictures import draw_contact_sheet
from dousa.motion.synthetic import draw_performer, make_motion
from dousa.retrieval.features import FEATURES, Feature

DOCS = Path(__file__).parent
FIGURES = DOCS / "figures"


def draw_sheet() -> None:
    """The contact sheet of one motion, as ``dousa plot`` draws it."""
    motion = make_motion("jumping_jack", draw_performer(4), seed=4)
    draw_contact_sheet(motion, FIGURES / "sheet.png", n_poses=10, title="jumping_jack.bvh")


def draw_demo() -> None:
    """The two pictures of ``dousa demo``."""
    with TemporaryDirectory() as folder:
        run_demo(Console(), None, Path(folder), seed=0)
        for name in ("search.png", "experiment.png"):
            (FIGURES / name).write_bytes((Path(folder) / name).read_bytes())


def describe_features() -> str:
    """The table of pose features in Markdown."""
    lines = [
        "# The 56 pose features",
        "",
        "Made from `dousa.retrieval.FEATURES` by `make figures`. Lengths are divided by the body height (eq. 2),",
        "angles are radians; the body-fixed system has its origin in the pelvis, its lateral axis along the hips,",
        "its vertical axis along gravity.",
        "",
        "| | feature | kind | joints | unit |",
        "| --- | --- | --- | --- | --- |",
    ]
    lines += [_row(number, feature) for number, feature in enumerate(FEATURES, 1)]
    return "\n".join(lines) + "\n"


def _row(number: int, feature: Feature) -> str:
    joints = ", ".join(joint.replace("_", " ") for joint in feature.joints)
    return f"| {number} | {feature.name} | {feature.kind} | {joints} | {feature.unit} |"


if __name__ == "__main__":
    import make_estimation_figures
    import make_evaluation_figures

    FIGURES.mkdir(exist_ok=True)
    draw_sheet()
    draw_demo()
    (DOCS / "features.md").write_text(describe_features(), encoding="utf-8")
    make_estimation_figures.make_all()
    make_evaluation_figures.make_all()
