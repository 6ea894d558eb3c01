"""A recipe: rounds of collecting bags and training on all of them, as Algorithm 1 of the paper alternates."""

from __future__ import annotations

from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from pydantic import Field

from raw2drive_ros.contracts.errors import ConfigError
from raw2drive_ros.contracts.near_names import unknown_name
from raw2drive_ros.settings import Strict, load_strict, params_folder

SEEDS_PER_ROUND, ROUNDS_PER_RUN = 10, 100


class Collection(Strict):
    """One `raw2drive collect`. Driver `privileged` is the policy at the end of the round before.

    focus: how many times a type is added to the routes if it failed on all its routes in the last two validations; a
    type that failed on a share of them is added in proportion.
    """

    driver: str
    ticks: int = Field(ge=1)
    noise: float = Field(0.0, ge=0.0, le=1.0)
    table: bool = False
    advice: bool = False
    advice_every: int = Field(4, ge=4)
    routes: str | None = None
    focus: int = Field(0, ge=0)

    @property
    def title(self) -> str:
        return f'{self.driver} {self.ticks} ticks'

    def arguments(
        self, recipe: Recipe, seed: int, checkpoint: Path, target: Path, failed: dict[str, float]
    ) -> list[str]:
        """Arguments of `raw2drive`. checkpoint: for driver `privileged`. failed: share of failed routes per type."""
        more = {kind: round(self.focus * share) for kind, share in sorted(failed.items())}
        routes = ','.join([self.routes or recipe.routes, *(f'{kind}*{n}' for kind, n in more.items() if n)])
        found = ['collect', '--driver', self.driver, '--routes', routes, '--no-cameras']
        found += ['--ticks', str(self.ticks), '--episode-ticks', str(recipe.episode_ticks)]
        found += ['--stand-ticks', str(recipe.stand_ticks), '--noise', str(self.noise)]
        found += ['--seed', str(seed), '--out', str(target)]
        if self.driver == 'privileged':
            found += ['--run', str(checkpoint)]
        return found + ['--table'] * self.table + ['--advice', '--advice-every', str(self.advice_every)] * self.advice


class Round(Strict):
    """collect: bags that are added to those of the rounds before. steps: gradient steps of this round.

    Both of these hold from this round on. set: training fields. without: patterns of folders of bags that are no longer
    trained on (`00_*_expert`).
    """

    collect: list[Collection] = Field(default_factory=list, max_length=SEEDS_PER_ROUND)
    steps: int = Field(ge=1)
    set: dict[str, Any] = Field(default_factory=dict)
    without: list[str] = Field(default_factory=list)


class Recipe(Strict):
    """routes: those that are collected on. set: training fields of all rounds. validation: the suite that is driven
    after every round; the round with the best score is exported. Empty: no validation, the last round is exported."""

    preset: str = 'laptop'
    routes: str = 'all'
    episode_ticks: int = 700
    stand_ticks: int = Field(0, ge=0)
    validation: str = 'validation'
    set: dict[str, Any] = Field(default_factory=dict)
    rounds: list[Round] = Field(min_length=1, max_length=ROUNDS_PER_RUN)

    def seed(self, training_seed: int, round_index: int, index: int) -> int:
        """The seed of a collection; other training seeds collect on other routes."""
        return (training_seed * ROUNDS_PER_RUN + round_index) * SEEDS_PER_ROUND + index

    def settings(self, round_index: int, overrides: dict[str, Any]) -> dict[str, Any]:
        """Training fields of a round: fields set in earlier rounds stay set, and `overrides` take precedence."""
        found = dict(self.set)
        for before in self.rounds[: round_index + 1]:
            found |= before.set
        return found | overrides

    def bags(self, round_index: int, folder: Path) -> list[Path]:
        """What a round trains on: the folders of bags below `folder` that no round so far leaves out."""
        patterns = [pattern for before in self.rounds[: round_index + 1] for pattern in before.without]
        if not patterns:
            return [folder]
        found = sorted(path for path in folder.iterdir() if path.is_dir())
        return [path for path in found if not any(fnmatchcase(path.name, pattern) for pattern in patterns)]

    def total_steps(self, round_index: int) -> int:
        """Gradient steps of the run at the end of a round."""
        return sum(r.steps for r in self.rounds[: round_index + 1])


def load_recipe(name: str) -> Recipe:
    """A YAML file, or the name of one in `params/recipes`. Raises ConfigError that names the field."""
    path = Path(name)
    if path.suffix != '.yaml':
        folder = params_folder() / 'recipes'
        path = folder / f'{name}.yaml'
        if not path.is_file():
            known = sorted(p.stem for p in folder.glob('*.yaml'))
            raise ConfigError(unknown_name('recipe', name, known, '; or give a .yaml file'))
    return load_strict(Recipe, path)
