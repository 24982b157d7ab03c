from .annotated.scores import AnnotatedTakesResult
from .annotated.trial import run_annotated_takes_experiment
from .metrics import Scores, compute_scores
from .recognition import ExperimentResult, run_experiment
from .runner import Split, leave_performer_out, split_half
from .table import ResultTable
from .takes import TakesResult, run_takes_experiment

__all__ = [
    "AnnotatedTakesResult",
    "ExperimentResult",
    "ResultTable",
    "Scores",
    "Split",
    "TakesResult",
    "compute_scores",
    "leave_performer_out",
    "run_annotated_takes_experiment",
    "run_experiment",
    "run_takes_experiment",
    "split_half",
]
