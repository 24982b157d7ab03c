"""The judge of the evaluation: trained, written into the package, and tried on a generator of errors left out.

Material: HDM05 (bd, bk), UTD-MHAD (s1, s3, s5), two thirds of Bandai-Namco 2's pairs, the first 42 s of a dance;
errors by three generators that differ in construction; made-up performers and real second takes, one to five
references. Prices of decoding are chosen on people and motions that are not trained on (HDM05's bk, UTD-MHAD's s5, a
quarter of the pairs, the dance's last third), and the table is of the same people, but of the generator that was left
out of both.

    python -m lab.training.train_judge ../shared/data --leave-out joints
    python -m lab.training.train_judge ../shared/data --write
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

import dousa.evaluation.errors
from dousa.evaluation import assess
from dousa.evaluation.errors.judge import Judge, use_judge
from lab.injection.generators import GENERATORS
from lab.injection.keyframes import inject_keyframes, perform_keyframes
from lab.injection.performers import vary_performer
from lab.training.judge_baseline import judge_plainly
from lab.training.judge_material import (
    Generator,
    Performer,
    Recording,
    Trial,
    make_trials,
    perform_steadily,
)
from lab.training.judge_metrics import KINDS, Report, Score
from lab.training.judge_recordings import read_recordings
from lab.training.judge_trial import (
    choose_decoding,
    describe_trials,
    is_left_out,
    thin,
    train_judge,
    weigh_all,
)

PERFORMERS: tuple[Performer, ...] = (perform_steadily, vary_performer)
_FILE = Path(dousa.evaluation.errors.__file__).with_name("judge.npz")
_SEED = 21


def learn(recordings: Sequence[Recording], generators: Mapping[str, Generator], rounds: int) -> Judge:
    """A judge that has seen these generators only; prices chosen on the people left out."""
    trained = [one for one in recordings if not is_left_out(one)]
    chosen = [one for one in recordings if is_left_out(one)]
    judge = train_judge(describe_trials(trained, generators, PERFORMERS, seed=_SEED, rounds=rounds))
    held = describe_trials(chosen, generators, PERFORMERS, seed=_SEED + 1, whole=True)
    return Judge(judge.limbs, judge.body, choose_decoding(weigh_all(judge, held), held))


def try_out(
    recordings: Sequence[Recording],
    generator: tuple[str, Generator],
    performers: Sequence[Performer],
    judges: Mapping[str, Callable[[Trial], Sequence[Report]]],
) -> None:
    """Print the table of one generator on people and motions left out."""
    trials = list(make_trials([thin(one) for one in recordings], dict([generator]), performers, seed=_SEED + 2))
    groups: dict[str, list[Trial]] = {"all": trials}
    for trial in trials:
        for name in (trial.set_name, f"{trial.carrier}, {len(trial.references)} references"):
            groups.setdefault(name, []).append(trial)
    print(f"\ngenerator left out: {generator[0]}; {len(trials)} performances")
    for title, judge in judges.items():
        answers = {id(trial): judge(trial) for trial in trials}
        for name, group in sorted(groups.items()):
            score = Score()
            for trial in group:
                score.add(answers[id(trial)], trial.errors, trial.performance.duration)
            print(_describe(title, name, score))
            if name == "all":
                rows = (f"{variant} {found}/{total}" for variant, (found, total) in sorted(score.found.items()))
                print("    " + "; ".join(rows))


def _describe(title: str, group: str, score: Score) -> str:
    by_class = " ".join(f"{kind} {score.f_of(kind):.2f}" for kind in KINDS)
    lag = np.mean(score.lags_ms) if score.lags_ms else np.nan
    short = np.mean(score.shortfalls_deg) if score.shortfalls_deg else np.nan
    return (
        f"{title:9s} {group:28s} macro F {score.macro_f:.3f} ({by_class})  lag {lag:.0f} ms, "
        f"shortfall {short:.1f} deg, false events a minute {score.false_per_minute:.1f}"
    )


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--leave-out", choices=[*GENERATORS, "keyframes"], help="generator of the table")
    parser.add_argument("--rounds", type=int, default=3, help="trials of each recording and generator")
    parser.add_argument("--write", action="store_true", help="write the judge of all three generators")
    options = parser.parse_args()
    start = time.time()
    recordings = [thin(one) for one in read_recordings(options.data)]
    generators = {name: one for name, one in GENERATORS.items() if name != options.leave_out}
    judge = learn(recordings, generators, options.rounds)
    print(f"{len(recordings)} recordings, {sorted(generators)}, {judge.decoding}, {time.time() - start:.0f} s")
    if options.write:
        np.savez_compressed(_FILE, **judge.to_arrays())
        print(f"{_FILE.name}: {_FILE.stat().st_size / 1e6:.1f} MB")
    if options.leave_out:
        kept = options.leave_out == "keyframes"
        generator = inject_keyframes if kept else GENERATORS[options.leave_out]
        use_judge(judge)
        judges = {
            "dousa": lambda trial: [
                Report.from_event(event) for event in assess(list(trial.references), trial.performance).events
            ],
            "baseline": lambda trial: judge_plainly(trial.references, trial.performance),
        }
        left_out = [one for one in recordings if is_left_out(one)]
        try_out(left_out, (options.leave_out, generator), [perform_keyframes] if kept else PERFORMERS, judges)


if __name__ == "__main__":
    main()
