"""Draw the answer of ``dousa experiment`` as figures 4 and 5 of the paper, for docs/retrieval.md."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from dousa.app.pictures.canvas import BLUE, FAINT, GREY, INK, PURPLE, new_figure, save_figure, write

_SYSTEMS = (
    ("full_tree", "single tree, every test", "#56B4E9", "//"),
    ("random_tree", "single random tree", PURPLE, ".."),
    ("forest", "random forest", BLUE, ""),
    ("motion_templates", "motion templates", "#E69F00", "\\\\"),
)
_MEASURES = (("recall", "recall"), ("precision", "precision"), ("f_measure", "F-measure"))


def draw_experiment_figure(
    result: Mapping[str, Any], path: str | os.PathLike[str], title: str = "Recall, precision and F-measure"
) -> None:
    """Draw figures 4 and 5 of Hamada, Kuriyama and Mukai: macro scores of the systems as grouped bars.

    Parameters
    ----------
    result : what ``dousa experiment --json`` prints: ``systems`` -> name -> measure; measures whose name ends
        in ``_std`` (standard deviation over the repeats) become error bars.
    path : .png, .svg or .pdf.
    title : of the figure.
    """
    systems = [entry for entry in _SYSTEMS if entry[0] in result.get("systems", {})]
    width, height = 9.0, 4.6
    figure = new_figure(width, height)
    axes = figure.add_axes((0.075, 0.08, 0.9, 0.65))
    bar = 0.8 / len(systems)
    for number, (key, label, colour, hatch) in enumerate(systems):
        numbers = result["systems"][key]
        values = [float(numbers[measure]) for measure, _ in _MEASURES]
        spread = [float(numbers.get(f"{measure}_std") or 0.0) for measure, _ in _MEASURES]
        x = np.arange(len(_MEASURES)) + (number - 0.5 * (len(systems) - 1)) * bar
        axes.bar(x, values, 0.92 * bar, color=colour, hatch=hatch, edgecolor="white", lw=0.6, label=label)
        if any(spread):
            axes.errorbar(x, values, spread, fmt="none", ecolor=INK, elinewidth=1.0, capsize=3)
        for position, value, error in zip(x, values, spread, strict=True):
            plate = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
            write(axes, position, value + error + 0.014, f"{value:.3f}", 8, ha="center", bbox=plate)
    axes.set_xticks(range(len(_MEASURES)), [label for _, label in _MEASURES], fontsize=10)
    axes.set(ylim=(0.0, 1.09), yticks=np.linspace(0, 1, 6))
    axes.grid(axis="y", color=FAINT, lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(length=0, labelsize=9)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.02), ncols=4, frameon=False, fontsize=9, columnspacing=1.4)
    write(figure, 0.03, 1 - 0.36 / height, title, 13, weight="bold")
    write(figure, 0.03, 1 - 0.6 / height, _experiment_facts(result), 9, color=GREY)
    save_figure(figure, path)


def _experiment_facts(result: Mapping[str, Any]) -> str:
    categories = result.get("categories", ())
    facts = f"{len(categories)} categories, {result.get('n_train', '?')} clips train, "
    facts += f"{result.get('n_test', '?')} are tested"
    if result.get("split"):
        facts += f" ({result['split']}, {result.get('repeats', 1)} x)"
    spread = any(system.get("f_measure_std") for system in result["systems"].values())
    return f"{facts}; whiskers: standard deviation over the repeats" if spread else facts
