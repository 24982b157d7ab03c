"""The forest in scikit-learn: cross validation, search of parameters, pipelines, and its own checks of estimators."""

import numpy as np
import pytest

from dousa import MotionForest

pytest.importorskip("sklearn", reason="scikit-learn is not installed: pip install 'dousa[map]'")
from sklearn.model_selection import GridSearchCV, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer
from sklearn.utils import check_array
from sklearn.utils.estimator_checks import check_estimator

FOREST = MotionForest(n_trees=5, random_state=0)
LABELS = "labels are words or whole numbers, one a clip"
# Checks of scikit-learn that it does not pass, and why.
EXPECTED = {
    "check_do_not_raise_errors_in_init_or_set_params": "a wrong parameter is refused where it is given",
    "check_estimators_unfitted": "NotTrainedError is ours: scikit-learn is optional",
    "check_n_features_in_after_fitting": "a clip has frames and features: n_features_in_ is for tables",
    "check_n_features_in": "as above",
    "check_dtype_object": LABELS,
    "check_estimators_nan_inf": LABELS,
    "check_classifiers_one_label": LABELS,
    "check_classifiers_regression_target": LABELS,
    "check_supervised_y_2d": LABELS,
    "check_requires_y_none": LABELS,
}


class OneFrame(MotionForest):
    """The forest on tables: a row is a clip of one frame, as most checks want to have it."""

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array, tags.input_tags.three_d_array = True, False
        return tags

    def fit(self, X, y):
        return super().fit(check_array(X)[:, None], y)

    def apply(self, X):
        return super().apply(check_array(X)[:, None])


@pytest.fixture(scope="module")
def clips():
    features = np.random.default_rng(0).normal(size=(40, 10, 56))
    features[:20, :, :10] += 1.0
    return features, np.repeat(["kick", "walk"], 20)


@pytest.mark.filterwarnings("ignore")
def test_the_checks_of_estimators_are_passed():
    found = check_estimator(OneFrame(n_trees=3, random_state=0), expected_failed_checks=EXPECTED, on_skip=None)
    failed = {one["check_name"] for one in found if one["status"] == "xfail"}
    assert failed == set(EXPECTED), "a check that passes now needs no reason"
    assert sum(one["status"] == "passed" for one in found) >= 35


@pytest.mark.parametrize(
    "estimator", [FOREST, make_pipeline(FunctionTransformer(), FOREST), GridSearchCV(FOREST, {"n_trees": [2, 5]}, cv=2)]
)
@pytest.mark.parametrize("scoring", [None, "f1_macro", "neg_log_loss"])
def test_clips_are_cross_validated(estimator, scoring, clips):
    scores = cross_val_score(estimator, *clips, scoring=scoring, cv=3, error_score="raise")
    assert scores.mean() > (-0.5 if scoring == "neg_log_loss" else 0.9)
