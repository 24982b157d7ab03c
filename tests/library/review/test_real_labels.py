"""Wrong labels planted into real recordings: how many are among the first of the list."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from dousa.library import Library

DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "hdm05"
SHARE, MOST = 0.05, 12  # wrong labels; clips of a category that are read


@pytest.mark.skipif(not DATA.is_dir(), reason="../shared/data/hdm05 is not here")
def test_wrong_labels_of_real_clips_are_the_first_of_the_list(tmp_path):
    folders = sorted(path for path in DATA.iterdir() if path.is_dir())[:6]
    with Library.open(tmp_path / "hdm.dousa", create=True) as library:
        for folder in folders:
            (tmp_path / "motions" / folder.name).mkdir(parents=True)
            for file in [*sorted(folder.glob("*.amc"))[:MOST], *DATA.glob("*.asf"), *folder.glob("*.asf")]:
                shutil.copyfile(file, tmp_path / "motions" / folder.name / file.name)
        library.add([tmp_path / "motions"])
        clips, chance = library.clips(), np.random.default_rng(0)
        names = sorted({clip.category for clip in clips})
        wrong = set()
        for place in chance.choice(len(clips), max(round(SHARE * len(clips)), 2), replace=False).tolist():
            others = [name for name in names if name != clips[place].category]
            library.relabel([clips[place].id], category=str(chance.choice(others)))
            wrong.add(clips[place].id)
        review = library.review_labels()
    assert len(clips) > 40
    found = [one.clip_id in wrong for one in review.doubts[: len(wrong)]]
    assert np.mean(found) >= 0.8
