from .annotated.scores import AnnotatedTakesResult
from .annotated.trial import run_annotated_takes_experiment
from .error_results import compute_overlap, match_events
from .errors import (
    NamedMotion,
    is_held_out,
    measure_false_alarms,
    measure_second_takes,
    run_error_experiment,
    run_severity_sweep,
)
from .injection.generators import GENERATORS
from .injection.injection import inject, inject_many, simulate_performer
from .injection.performers import Variation, vary_performer
from .metrics import Scores, bootstrap_interval, compute_scores, score_ranking
from .novelty import NoveltyResult, run_novelty_experiment
from .pose import run_bench
from .pose_metrics import Accuracy, compare_in_images, compare_with_truth, compute_iou
from .ranking import RankingResult, run_ranking_experiment
from .readings import run_reading_table
from .recognition import ExperimentResult, run_experiment
from .runner import Split, leave_performer_out, split_half
from .table import ResultTable
from .takes import TakesResult, run_takes_experiment

__all__ = [
    "GENERATORS",
    "Accuracy",
    "AnnotatedTakesResult",
    "ExperimentResult",
    "NamedMotion",
    "NoveltyResult",
    "RankingResult",
    "ResultTable",
    "Scores",
    "Split",
    "TakesResult",
    "Variation",
    "bootstrap_interval",
    "compare_in_images",
    "compare_with_truth",
    "compute_iou",
    "compute_overlap",
    "compute_scores",
    "inject",
    "inject_many",
    "is_held_out",
    "leave_performer_out",
    "match_events",
    "measure_false_alarms",
    "measure_second_takes",
    "run_annotated_takes_experiment",
    "run_bench",
    "run_error_experiment",
    "run_experiment",
    "run_novelty_experiment",
    "run_ranking_experiment",
    "run_reading_table",
    "run_severity_sweep",
    "run_takes_experiment",
    "score_ranking",
    "simulate_performer",
    "split_half",
    "vary_performer",
]
