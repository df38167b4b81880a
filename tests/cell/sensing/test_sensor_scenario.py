"""The camera class as a scenario names it."""

from __future__ import annotations

from pathlib import Path

import pytest

from pickproof.cell.errors import InputError
from pickproof.cell.sensing.sensor_model import SensorConfig
from pickproof.scenarios.config.scenario import Scenario, load_scenario, scenario_json


def test_a_scenario_names_a_preset_and_replaces_single_fields(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\nworkpiece: bracket\nsensor: {preset: stereo, baseline: 0.095}\n")
    stereo = SensorConfig.of_preset("stereo")
    assert load_scenario(str(path)).sensor == stereo.model_copy(update={"baseline": 0.095})
    assert load_scenario(str(path), ["sensor.flying=0.2"]).sensor.flying == 0.2
    assert load_scenario("bracket", ["sensor.preset=stereo"]).sensor == stereo
    assert load_scenario("bracket").sensor == SensorConfig()


def test_the_effective_scenario_comes_back_as_it_was() -> None:
    scenario = load_scenario("bracket", ["sensor.preset=stereo", "sensor.baseline=0.05"])
    assert Scenario.model_validate_json(scenario_json(scenario)) == scenario


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("sensor.preset=lidar", "sensor.preset: 'lidar' is not valid; expected one of: stereo, structured_light"),
        ("sensor.flyng=0.1", "sensor.flyng: 0.1 is not valid; expected no such field; one of: enabled, preset, axial_"),
        ("sensor.flying=2", "sensor.flying: 2 is not valid; expected less than or equal to 1"),
    ],
)
def test_bad_input_is_said_in_one_line(override: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        load_scenario("bracket", [override])
    assert message in str(caught.value) and "\n" not in str(caught.value)
