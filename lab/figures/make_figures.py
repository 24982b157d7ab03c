"""Draw the pictures of the documents again, and print the tables of features: ``make figures``.

Everything shown is made by the package itself: no recording is needed. `make_retrieval_figures`,
`make_estimation_figures` and `make_evaluation_figures` do the same for docs/retrieval.md, docs/estimation.md and
docs/evaluation.md. `make_studio_figures` takes pictures of the studio's
pages. Only `make_chain_figures`, for docs/tutorial.md, shows real people, and does nothing without them.
"""

from __future__ import annotations

import json
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

from dousa.app.cli.main import make_application
from dousa.app.demo import PERFORMER_RULE
from dousa.app.pictures.sheets import draw_contact_sheet
from dousa.motion.synthetic.performers import draw_performer, make_motion
from dousa.retrieval.features.channels import CHANNELS, Channel
from dousa.retrieval.features.pose_features import FEATURES, Feature
from lab.figures.experiment_figure import draw_experiment_figure
from lab.places import DOCS

FIGURES = DOCS / "figures"


def draw_sheet() -> None:
    """The contact sheet of one motion, as ``dousa plot`` draws it."""
    motion = make_motion("jumping_jack", draw_performer(4), seed=4)
    draw_contact_sheet(motion, FIGURES / "sheet.png", n_poses=10, title="jumping_jack.bvh")


def draw_demo() -> None:
    """The pictures of the commands of ``dousa demo`` and of an experiment on its library."""
    with TemporaryDirectory() as folder:
        make_application()(["demo", "-o", folder], standalone_mode=False)
        words = [f"{folder}/motions", "--split", "leave-performer-out", "--performer-from", PERFORMER_RULE]
        with redirect_stdout(StringIO()) as said:
            make_application()(["experiment", *words, "--json"], standalone_mode=False)
        draw_experiment_figure(json.loads(said.getvalue()), FIGURES / "experiment.png")
        for name in ("search.png", "timeline.png"):
            (FIGURES / name).write_bytes((Path(folder) / name).read_bytes())


def describe_features() -> str:
    """The tables of pose features and of channels in Markdown."""
    lines = [
        "# Features",
        "",
        "Generated from `dousa.retrieval` by `make figures`. Lengths are divided by the body height (eq. 2), angles",
        "are radians; the body-fixed frame has its origin in the pelvis, its lateral axis along the hips, its",
        "vertical axis along gravity. Their use is described in [retrieval](retrieval.md).",
        "",
        f"## `paper`: {len(FEATURES)} pose features",
        "",
        "For each the means over the 55 intervals of a clip that is downsampled to 10 frames.",
        "",
        "| | feature | kind | joints | unit |",
        "| --- | --- | --- | --- | --- |",
    ]
    lines += [_row(number, feature) for number, feature in enumerate(FEATURES, 1)]
    lines += [
        "",
        f"## `extended`: {len(CHANNELS)} channels",
        "",
        "For each the mean, the spread and the trend over the 55 intervals of a clip that is divided into 10 cells of",
        "equal movement; and the duration of the clip in seconds. Channels that measure the same thing in other",
        "directions share a row, with their numbers: they form one relation, and a reason is about a relation.",
        "",
        "| | relation | channels | unit |",
        "| --- | --- | --- | --- |",
    ]
    lines += _channel_rows()
    return "\n".join(lines) + "\n"


def _channel_rows() -> list[str]:
    """One row per relation; channels of one relation share a row."""
    relations: dict[str, list[tuple[int, Channel]]] = {}
    for number, channel in enumerate(CHANNELS, 1):
        relations.setdefault(channel.relation, []).append((number, channel))
    rows = []
    for relation, members in relations.items():
        first, last = members[0][0], members[-1][0]
        numbers = f"{first}" if first == last else f"{first} to {last}"
        names = "; ".join(channel.name for _, channel in members) if len(members) > 1 else "the same"
        rows.append(f"| {numbers} | {relation} | {names} | {members[0][1].unit} |")
    return rows


def _row(number: int, feature: Feature) -> str:
    joints = ", ".join(joint.replace("_", " ") for joint in feature.joints)
    return f"| {number} | {feature.name} | {feature.kind} | {joints} | {feature.unit} |"


if __name__ == "__main__":
    from lab.figures import (
        make_chain_figures,
        make_estimation_figures,
        make_evaluation_figures,
        make_retrieval_figures,
        make_studio_figures,
        translated_tutorial,
    )

    FIGURES.mkdir(exist_ok=True)
    draw_sheet()
    draw_demo()
    (DOCS / "features.md").write_text(describe_features(), encoding="utf-8")
    make_retrieval_figures.make_all()
    make_estimation_figures.make_all()
    make_evaluation_figures.make_all()
    make_studio_figures.make_all()
    make_chain_figures.make_all()
    translated_tutorial.update_translation()
