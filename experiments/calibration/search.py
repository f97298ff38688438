"""The optimiser: optuna's tree of Parzen estimators, which copes with noise, with switches and with few evaluations.

Every evaluation is appended to a journal; the same call again goes on after the last one.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import Trial, TrialState

from experiments.calibration.spaces import Range, Space


def search(
    space: Space,
    objective: Callable[[dict[str, Any]], float],
    start: Mapping[str, Any],
    trials: int,
    journal: Path,
    note: Callable[[int, float], None] = lambda *_: None,
) -> optuna.Study:
    """Look for the settings of the least `objective`.

    Args:
        start: settings that are evaluated first, those of today.
        trials: evaluations in all, those in the journal included.
        journal: file of the evaluations.
        note: called with the number of evaluations and the least value so far, after each.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)  # a failed trial raises; it is not logged as well
    warnings.filterwarnings("ignore", category=optuna.exceptions.ExperimentalWarning)
    study = optuna.create_study(
        study_name=journal.stem,
        storage=JournalStorage(JournalFileBackend(str(journal))),
        sampler=optuna.samplers.TPESampler(seed=0, n_startup_trials=10, multivariate=True),
        load_if_exists=True,
    )

    def evaluate(trial: Trial) -> float:
        settings: dict[str, Any] = {}
        for name, values in space.items():
            if isinstance(values, Range):
                settings[name] = trial.suggest_float(name, values.low, values.high, log=values.log)
            else:
                settings[name] = trial.suggest_categorical(name, values)
        return objective(settings)

    if not study.get_trials(states=(TrialState.COMPLETE, TrialState.WAITING)):
        study.enqueue_trial({name: start[name] for name in space})
    while (done := len(study.get_trials(states=(TrialState.COMPLETE,)))) < trials:
        study.optimize(evaluate, n_trials=1)
        note(done + 1, study.best_value)
    return study
