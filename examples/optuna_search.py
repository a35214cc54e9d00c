"""Search for hyperparameters by Optuna (`pip install optuna`): a trial ends early if its validation falls behind.

Each trial is a run of `train.py`, resumed part by part. Learning rates are constant: a schedule would end with a part.
"""

from pathlib import Path

import optuna
import tyro

from lidarnaut.agents.curves import curve_of, headline_of_rows, read_evaluations
from lidarnaut.agents.training import train


def main(
    config: str = "reach", trials: int = 20, steps: int = 300_000, parts: int = 6, out: Path = Path("runs/optuna")
) -> optuna.Study:
    """Train `trials` times for at most `steps` steps in `parts` parts, and return the study."""

    def objective(trial: optuna.Trial) -> float:
        run, changes = out / f"trial_{trial.number:03d}", {"evaluation.references": [], "evaluation.test_episodes": 1}
        changes["hyperparameters.learning_rate"] = trial.suggest_float("learning_rate", 1e-4, 3e-3, log=True)
        changes["hyperparameters.ent_coef"] = trial.suggest_float("ent_coef", 1e-4, 1e-2, log=True)
        for part in range(1, parts + 1):
            changes["total_steps"] = steps * part // parts
            train(config, changes, **{"resume" if part > 1 else "run": run})
            curve = curve_of(read_evaluations(run))
            value = float(curve[-1][headline_of_rows(curve)])
            trial.report(value, part)
            if trial.should_prune():
                raise optuna.TrialPruned
        return value

    study = optuna.create_study(direction="maximize", pruner=optuna.pruners.MedianPruner(n_startup_trials=4))
    study.optimize(objective, trials)
    return study


if __name__ == "__main__":
    print(tyro.cli(main).best_params)
