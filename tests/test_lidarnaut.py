"""The configurations of the package `lidarnaut` by name; `test_wheel.py` tests its ids and version."""

from pathlib import Path

import pytest

import evaluate
import train
from lidarnaut import find_configuration

ROOT = Path(__file__).parents[1]


def test_configurations_go_by_name_or_path(tmp_path, monkeypatch):
    assert find_configuration("explore_frontiers") == ROOT / "configs" / "explore_frontiers.yaml"
    assert find_configuration("configs/mine.yaml") == Path("configs/mine.yaml")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").write_text("experiment: mine\n")
    assert find_configuration("mine") == Path("mine")


def test_names_of_configurations_that_do_not_exist_say_which_do(tmp_path, capsys):
    names = {path.stem for path in (ROOT / "configs").glob("*.yaml")}
    with pytest.raises(ValueError, match="did you mean 'explore_frontiers'") as error:
        find_configuration("explore_frontier")
    assert names <= set(str(error.value).replace(",", " ").split())
    assert train.main(["--config", "rooms_smal"]) == 2
    assert "did you mean 'rooms_small'" in capsys.readouterr().err
    assert evaluate.main(["--config", "arenas", "--out", str(tmp_path)]) == 2
    assert "did you mean 'arena'" in " ".join(capsys.readouterr().err.split())
